"""Interpolation on SE(3) with continuous acceleration: a quintic for the position, one for the rotation vector.

Between two knots h apart, with u the time since the first one ::

    p(u) = p_0 + x(u) ,    R(u) = R_0 exp(theta(u))

where x and theta are the polynomials of degree 5 that meet pose, velocity and acceleration of both knots, the rates of
theta being tied to the body's as :mod:`ik_node.trajectory.so3` says. So whatever rates the knots are given, poses,
twists and their derivatives are continuous (C2), and the knots are met to rounding.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from ik_node.se3 import Array
from ik_node.trajectory.reference import RigidMotion
from ik_node.trajectory.rotations import (
    Quaternion,
    Vector,
    conjugate,
    from_vector,
    multiply,
    normalised,
    rotate_back,
)
from ik_node.trajectory.so3 import inverse_right_jacobian, right_jacobian, right_jacobian_rate, turns_between

NEAREST_STEPS = 4
"""Newton steps of :meth:`RigidSpline.nearest`."""


class Knots(NamedTuple):
    """What a spline goes through. Everything seen from {s}, but rates and angular accelerations written in the knot's
    own frame."""

    times_s: Array
    """(N,), increasing, N >= 2."""
    positions: Array
    """(N, 3), m."""
    orientations: tuple[Quaternion, ...]
    """N unit quaternions (w, x, y, z)."""
    velocities: Array
    """(N, 3), m/s."""
    rates: Array
    """(N, 3), rad/s."""
    accelerations: Array
    """(N, 3), m/s2."""
    angular_accelerations: Array
    """(N, 3), rad/s2."""


class RigidSpline:
    """The C2 motion through :class:`Knots`; immutable. Times are seconds on the knots' own scale."""

    def __init__(self, knots: Knots) -> None:
        self.knots = knots
        steps = np.diff(knots.times_s)[:, None]
        turns = turns_between(knots.orientations)
        ends = inverse_right_jacobian(turns, knots.rates[1:])
        bends = inverse_right_jacobian(turns, knots.angular_accelerations[1:] - right_jacobian_rate(turns, ends, ends))
        linear = _quintic(
            np.diff(knots.positions, axis=0),
            (knots.velocities[:-1], knots.accelerations[:-1]),
            (knots.velocities[1:], knots.accelerations[1:]),
            steps,
        )
        angular = _quintic(turns, (knots.rates[:-1], knots.angular_accelerations[:-1]), (ends, bends), steps)
        self._times: list[float] = knots.times_s.tolist()
        self._points: list[list[float]] = knots.positions.tolist()
        self._linear: list[list[list[float]]] = linear.tolist()
        self._angular: list[list[list[float]]] = angular.tolist()

    @property
    def begin_s(self) -> float:
        """Time of the first knot."""
        return self._times[0]

    @property
    def end_s(self) -> float:
        """Time of the last knot."""
        return self._times[-1]

    def pose(self, time_s: float) -> tuple[Vector, Quaternion]:
        """Position [m] and orientation (w, x, y, z); held at its ends outside ``begin_s .. end_s``."""
        index, u = self._place(time_s)
        theta = _value(self._angular[index], u)
        return self._position(index, u), normalised(multiply(self.knots.orientations[index], from_vector(theta)))

    def motion(self, time_s: float) -> RigidMotion:
        """Pose, velocity and acceleration; outside ``begin_s .. end_s`` those of its ends."""
        index, u = self._place(time_s)
        angular = self._angular[index]
        theta = _value(angular, u)
        vectors = np.array([theta]), np.array([_slope(angular, u)]), np.array([_bend(angular, u)])
        rate = right_jacobian(vectors[0], vectors[1])
        change = right_jacobian(vectors[0], vectors[2]) + right_jacobian_rate(*vectors[:2], vectors[1])
        orientation = normalised(multiply(self.knots.orientations[index], from_vector(theta)))
        back = conjugate(orientation)
        return RigidMotion(
            self._position(index, u),
            _slope(self._linear[index], u),
            _bend(self._linear[index], u),
            orientation,
            rotate_back(back, _tuple(rate[0])),
            rotate_back(back, _tuple(change[0])),
        )

    def derivatives(self, per_interval: int) -> tuple[Array, Array, Array]:
        """Times (M,) of so many points in each interval and the end, with the velocities of the origin and of turning
        (M, 6), in {s} and in the moving frame, and their derivatives (M, 6)."""
        parts = np.arange(per_interval) / per_interval
        steps = np.diff(self.knots.times_s)
        u = np.concatenate((np.outer(steps, parts).ravel(), steps[-1:]))
        index = np.concatenate((np.repeat(np.arange(len(steps)), per_interval), [len(steps) - 1]))
        linear, angular = np.array(self._linear)[index], np.array(self._angular)[index]
        powers = np.arange(1.0, 6.0)
        value, slope = u[:, None] ** powers, powers * u[:, None] ** (powers - 1.0)
        bend = powers[1:] * (powers[1:] - 1.0) * u[:, None] ** (powers[1:] - 2.0)
        theta, rate = np.einsum("mk,mkj->mj", value, angular), np.einsum("mk,mkj->mj", slope, angular)
        change = right_jacobian(theta, np.einsum("mk,mkj->mj", bend, angular[:, 1:]))
        return (
            self.knots.times_s[index] + u,
            np.concatenate((np.einsum("mk,mkj->mj", slope, linear), right_jacobian(theta, rate)), axis=1),
            np.concatenate(
                (
                    np.einsum("mk,mkj->mj", bend, linear[:, 1:]),
                    change + right_jacobian_rate(theta, rate, rate),
                ),
                axis=1,
            ),
        )

    def nearest(self, position: Vector, time_s: float) -> tuple[float, float]:
        """Time at which the path is nearest to ``position``, looked for downhill from ``time_s``, and how near [m]."""
        best_s, best = time_s, self._squared_distance(position, time_s)
        now_s = time_s
        for _ in range(NEAREST_STEPS):
            index, u = self._place(now_s)
            x, y, z = self._position(index, u)
            a, b, c = x - position[0], y - position[1], z - position[2]
            v, w = _slope(self._linear[index], u), _bend(self._linear[index], u)
            speed = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
            curvature = speed + a * w[0] + b * w[1] + c * w[2]
            if speed <= 1e-18:
                break
            step = (a * v[0] + b * v[1] + c * v[2]) / (curvature if curvature > 0.25 * speed else speed)
            now_s = min(max(now_s - step, self.begin_s), self.end_s)
            squared = self._squared_distance(position, now_s)
            if squared < best:
                best_s, best = now_s, squared
        return best_s, best**0.5

    def _squared_distance(self, position: Vector, time_s: float) -> float:
        x, y, z = self._position(*self._place(time_s))
        return (x - position[0]) ** 2 + (y - position[1]) ** 2 + (z - position[2]) ** 2

    def _place(self, time_s: float) -> tuple[int, float]:
        times = self._times
        inside = min(max(time_s, times[0]), times[-1])
        index = min(bisect_right(times, inside) - 1, len(times) - 2)
        return index, inside - times[index]

    def _position(self, index: int, u: float) -> Vector:
        x, y, z = _value(self._linear[index], u)
        a, b, c = self._points[index]
        return (a + x, b + y, c + z)


def _value(rows: list[list[float]], u: float) -> Vector:
    """The polynomials with coefficients ``rows`` of u .. u^5, one column per axis, at ``u``."""
    (a1, b1, c1), (a2, b2, c2), (a3, b3, c3), (a4, b4, c4), (a5, b5, c5) = rows
    return (
        u * (a1 + u * (a2 + u * (a3 + u * (a4 + u * a5)))),
        u * (b1 + u * (b2 + u * (b3 + u * (b4 + u * b5)))),
        u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))),
    )


def _slope(rows: list[list[float]], u: float) -> Vector:
    """Their first derivatives."""
    (a1, b1, c1), (a2, b2, c2), (a3, b3, c3), (a4, b4, c4), (a5, b5, c5) = rows
    return (
        a1 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + u * 5.0 * a5))),
        b1 + u * (2.0 * b2 + u * (3.0 * b3 + u * (4.0 * b4 + u * 5.0 * b5))),
        c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5))),
    )


def _bend(rows: list[list[float]], u: float) -> Vector:
    """Their second derivatives."""
    _, (a2, b2, c2), (a3, b3, c3), (a4, b4, c4), (a5, b5, c5) = rows
    return (
        2.0 * a2 + u * (6.0 * a3 + u * (12.0 * a4 + u * 20.0 * a5)),
        2.0 * b2 + u * (6.0 * b3 + u * (12.0 * b4 + u * 20.0 * b5)),
        2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)),
    )


def _tuple(values: Array) -> Vector:
    x, y, z = values.tolist()
    return (x, y, z)


def _quintic(way: Array, begin: tuple[Array, Array], end: tuple[Array, Array], steps: Array) -> Array:
    """Coefficients (N, 5, 3) of u .. u^5 from 0 to ``way`` (N, 3), with (velocity, acceleration) at both ends."""
    (v0, a0), (v1, a1) = begin, end
    h = steps
    d = way - h * (v0 + 0.5 * h * a0)
    v = h * (v1 - v0 - h * a0)
    a = 0.5 * h * h * (a1 - a0)
    third = (10.0 * d - 4.0 * v + a) / h**3
    fourth = (-15.0 * d + 7.0 * v - 2.0 * a) / h**4
    fifth = (6.0 * d - 3.0 * v + a) / h**5
    return np.stack((v0, 0.5 * a0, third, fourth, fifth), axis=1)

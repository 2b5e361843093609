"""Interpolation on SE(3) with continuous acceleration: a quintic for the position, one for the rotation vector.

Between two knots h apart, with u the time since the first one ::

    p(u) = p_0 + x(u) ,    R(u) = R_0 exp(theta(u))

where x and theta are the polynomials of degree 5 that have the pose, velocity and acceleration of both knots; the rates
of theta follow from those of the body by :mod:`ik_node.math.so3`. So for any rates at the knots, poses, twists and
their derivatives are continuous (C2), and the spline passes through the knots up to rounding.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    Quaternion,
    Vector,
    add,
    difference,
    dot,
    from_rotation_vector,
    multiply,
    normalised,
    rotate,
    scaled,
)
from ik_node.math.so3 import (
    inverse_right_jacobian,
    relative_rotation_vectors,
    right_jacobian,
    right_jacobian_product,
    right_jacobian_rate,
    right_jacobian_rate_product,
)
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import RigidMotion

NEAREST_STEPS = 4
"""Newton steps of :meth:`RigidSpline.nearest`."""


class Knots(NamedTuple):
    """Poses and derivatives on a spline, relative to {s}; the angular derivatives are in the frame of the knot."""

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


class SplineTable(NamedTuple):
    """The numbers of a spline, for compiled functions."""

    times_s: Array
    """(N,), of the knots."""
    places: Array
    """(N, 7): position and quaternion (w, x, y, z) of each knot."""
    coefficients: Array
    """(N - 1, 5, 6): of u .. u^5, for position and rotation vector."""


class RigidSpline:
    """The C2 motion through :class:`Knots`; immutable. Times are on the scale of the knots."""

    def __init__(self, knots: Knots) -> None:
        self.knots = knots
        steps = np.diff(knots.times_s)[:, None]
        turns = relative_rotation_vectors(knots.orientations)
        ends = inverse_right_jacobian(turns, knots.rates[1:])
        bends = inverse_right_jacobian(turns, knots.angular_accelerations[1:] - right_jacobian_rate(turns, ends, ends))
        linear = _quintic(
            np.diff(knots.positions, axis=0),
            (knots.velocities[:-1], knots.accelerations[:-1]),
            (knots.velocities[1:], knots.accelerations[1:]),
            steps,
        )
        angular = _quintic(turns, (knots.rates[:-1], knots.angular_accelerations[:-1]), (ends, bends), steps)
        places = np.concatenate((knots.positions, np.array(knots.orientations)), axis=1)
        self.table = SplineTable(
            np.array(knots.times_s, dtype=np.float64), places, np.concatenate((linear, angular), axis=2)
        )
        """For compiled functions."""

    @property
    def begin_s(self) -> float:
        """Time of the first knot."""
        return float(self.table.times_s[0])

    @property
    def end_s(self) -> float:
        """Time of the last knot."""
        return float(self.table.times_s[-1])

    def pose(self, time_s: float) -> tuple[Vector, Quaternion]:
        """Position [m] and orientation (w, x, y, z); constant outside ``begin_s .. end_s``."""
        return pose_on(self.table, time_s)

    def motion(self, time_s: float) -> RigidMotion:
        """Pose, velocity and acceleration; outside ``begin_s .. end_s`` those of its ends."""
        return motion_on(self.table, time_s)

    def derivatives(self, per_interval: int) -> tuple[Array, Array, Array]:
        """Times (M,) of so many points in each interval and the end, with the velocities of the origin and of turning
        (M, 6), in {s} and in the moving frame, and their derivatives (M, 6)."""
        parts = np.arange(per_interval) / per_interval
        steps = np.diff(self.knots.times_s)
        u = np.concatenate((np.outer(steps, parts).ravel(), steps[-1:]))
        index = np.concatenate((np.repeat(np.arange(len(steps)), per_interval), [len(steps) - 1]))
        linear, angular = np.split(self.table.coefficients[index], 2, axis=2)
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
        """Time and distance [m] of the point next to ``position``, found by descent from ``time_s``."""
        return nearest_on(self.table, position, time_s)


# --- compiled ---------------------------------------------------------------------------------------------------------


@compiled
def pose_on(spline: SplineTable, time_s: float) -> tuple[Vector, Quaternion]:
    """:meth:`RigidSpline.pose`."""
    index, u = _place(spline.times_s, time_s)
    knot = spline.places[index]
    theta = _value(spline.coefficients, index, 3, u)
    turned = normalised(multiply((knot[3], knot[4], knot[5], knot[6]), from_rotation_vector(theta)))
    return _position(spline, index, u), turned


@compiled
def motion_on(spline: SplineTable, time_s: float) -> RigidMotion:
    """:meth:`RigidSpline.motion`."""
    coefficients = spline.coefficients
    index, u = _place(spline.times_s, time_s)
    theta, slope = _value(coefficients, index, 3, u), _slope(coefficients, index, 3, u)
    bend = _bend(coefficients, index, 3, u)
    change = add(right_jacobian_product(theta, bend), right_jacobian_rate_product(theta, slope, slope))
    position, orientation = pose_on(spline, time_s)
    return RigidMotion(
        position,
        _slope(coefficients, index, 0, u),
        _bend(coefficients, index, 0, u),
        orientation,
        rotate(orientation, right_jacobian_product(theta, slope)),
        rotate(orientation, change),
    )


@compiled
def nearest_on(spline: SplineTable, position: Vector, time_s: float) -> tuple[float, float]:
    """:meth:`RigidSpline.nearest`."""
    times_s, coefficients = spline.times_s, spline.coefficients
    best_s, best = time_s, _squared_distance(spline, position, time_s)
    now_s = time_s
    for _ in range(NEAREST_STEPS):
        index, u = _place(times_s, now_s)
        away = difference(_position(spline, index, u), position)
        v, w = _slope(coefficients, index, 0, u), _bend(coefficients, index, 0, u)
        speed = dot(v, v)
        curvature = speed + dot(away, w)
        if speed <= 1e-18:
            break
        step = dot(away, v) / (curvature if curvature > 0.25 * speed else speed)
        now_s = min(max(now_s - step, times_s[0]), times_s[-1])
        squared = _squared_distance(spline, position, now_s)
        if squared < best:
            best_s, best = now_s, squared
    return best_s, sqrt(best)


@compiled
def _squared_distance(spline: SplineTable, position: Vector, time_s: float) -> float:
    index, u = _place(spline.times_s, time_s)
    away = difference(_position(spline, index, u), position)
    return dot(away, away)


@compiled
def _place(times_s: Array, time_s: float) -> tuple[int, float]:
    """Number of the interval, and the time since its beginning."""
    inside = min(max(time_s, times_s[0]), times_s[-1])
    index = min(int(np.searchsorted(times_s, inside, side="right")) - 1, len(times_s) - 2)
    return index, inside - times_s[index]


@compiled
def _position(spline: SplineTable, index: int, u: float) -> Vector:
    knot = spline.places[index]
    return add((knot[0], knot[1], knot[2]), _value(spline.coefficients, index, 0, u))


@compiled
def _value(coefficients: Array, index: int, first: int, u: float) -> Vector:
    """The polynomials of one interval at ``u``: those of the position from ``first`` = 0, of the rotation from 3."""
    a, b, c, d, e = _columns(coefficients, index, first)
    return scaled(add(a, scaled(add(b, scaled(add(c, scaled(add(d, scaled(e, u)), u)), u)), u)), u)


@compiled
def _slope(coefficients: Array, index: int, first: int, u: float) -> Vector:
    """Their first derivatives."""
    a, b, c, d, e = _columns(coefficients, index, first)
    inner = add(scaled(d, 4.0), scaled(e, 5.0 * u))
    return add(a, scaled(add(scaled(b, 2.0), scaled(add(scaled(c, 3.0), scaled(inner, u)), u)), u))


@compiled
def _bend(coefficients: Array, index: int, first: int, u: float) -> Vector:
    """Their second derivatives."""
    _, b, c, d, e = _columns(coefficients, index, first)
    inner = add(scaled(d, 12.0), scaled(e, 20.0 * u))
    return add(scaled(b, 2.0), scaled(add(scaled(c, 6.0), scaled(inner, u)), u))


@compiled
def _columns(coefficients: Array, index: int, first: int) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Coefficients of u .. u^5 of three neighbouring polynomials."""
    a, b, c, d, e = coefficients[index]
    i, j, k = first, first + 1, first + 2
    return (a[i], a[j], a[k]), (b[i], b[j], b[k]), (c[i], c[j], c[k]), (d[i], d[j], d[k]), (e[i], e[j], e[k])


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

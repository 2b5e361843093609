"""The newest samples of a stream, and the smooth curve through them that says where the target is now."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ik_node.se3 import Array
from ik_node.trajectory.reference import RigidMotion
from ik_node.trajectory.rotations import ZERO, Quaternion, Vector, conjugate, from_vector, multiply, to_vector


class Sample(NamedTuple):
    """One pose of the stream."""

    time_ns: int
    """When it held, on the monotonic clock."""
    received_ns: int
    position: Vector
    orientation: Quaternion


class Curve(NamedTuple):
    """Position and rotation vector about the newest sample, as polynomials of degree 2 in the time since it."""

    position: Vector
    velocity: Vector
    acceleration: Vector
    turn: Vector
    """Rotation vector in {s} from ``orientation``."""
    rate: Vector
    angular_acceleration: Vector
    orientation: Quaternion
    """Of the newest sample."""


def resting(position: Vector, orientation: Quaternion) -> Curve:
    """The curve that stays at one pose."""
    return Curve(position, ZERO, ZERO, ZERO, ZERO, ZERO, orientation)


def fit(samples: Sequence[Sample], degree: int) -> Curve:
    """Least squares through ``samples`` (oldest first; at least degree + 1 of them, at different times)."""
    newest = samples[-1]
    back = conjugate(newest.orientation)
    rows = [(*s.position, *to_vector(multiply(s.orientation, back))) for s in samples]
    scale = (newest.time_ns - samples[0].time_ns) * 1e-9
    times = np.array([(s.time_ns - newest.time_ns) * 1e-9 / scale for s in samples])
    powers: Array = np.vander(times, degree + 1, increasing=True)
    solved = np.linalg.solve(powers.T @ powers, powers.T @ np.array(rows))
    c0 = solved[0].tolist()
    c1 = (solved[1] / scale).tolist()
    c2 = (solved[2] * (2.0 / (scale * scale))).tolist() if degree > 1 else [0.0] * 6
    return Curve(
        tuple(c0[:3]), tuple(c1[:3]), tuple(c2[:3]), tuple(c0[3:]), tuple(c1[3:]), tuple(c2[3:]), newest.orientation
    )


def evaluate(curve: Curve, age: float, pace: float, pace_change: float) -> RigidMotion:
    """The motion along ``curve`` at ``age`` seconds after its newest sample.

    ``pace`` is d(age)/dt and ``pace_change`` [1/s] its derivative: 1 and 0 while time runs as it does.
    """
    position, velocity, acceleration = _polynomial(curve.position, curve.velocity, curve.acceleration, age)
    turn, slope, bend = _polynomial(curve.turn, curve.rate, curve.angular_acceleration, age)
    rate = _left_jacobian(turn, slope)
    angular_acceleration = _left_jacobian(turn, bend)
    if pace != 1.0:
        acceleration = _mix(acceleration, pace * pace, velocity, pace_change)
        angular_acceleration = _mix(angular_acceleration, pace * pace, rate, pace_change)
        velocity = _mix(velocity, pace, velocity, 0.0)
        rate = _mix(rate, pace, rate, 0.0)
    orientation = multiply(from_vector(turn), curve.orientation)
    return RigidMotion(position, velocity, acceleration, orientation, rate, angular_acceleration)


def _polynomial(p: Vector, v: Vector, a: Vector, t: float) -> tuple[Vector, Vector, Vector]:
    half = 0.5 * t
    return (
        (p[0] + t * (v[0] + half * a[0]), p[1] + t * (v[1] + half * a[1]), p[2] + t * (v[2] + half * a[2])),
        (v[0] + t * a[0], v[1] + t * a[1], v[2] + t * a[2]),
        a,
    )


def _left_jacobian(turn: Vector, slope: Vector) -> Vector:
    """J_l(turn) slope to first order: turns are those of a sample period, where the rest is below 1 %."""
    x, y, z = turn
    a, b, c = slope
    return (a + 0.5 * (y * c - z * b), b + 0.5 * (z * a - x * c), c + 0.5 * (x * b - y * a))


def _mix(a: Vector, s: float, b: Vector, t: float) -> Vector:
    return (s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2])

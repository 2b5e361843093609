"""The curve that a streamed target is taken to follow about its newest sample."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.jit import compiled
from ik_node.math.quaternion import ZERO, Quaternion, Vector, from_rotation_vector, multiply
from ik_node.targets.jerk_limited_filter import RigidMotion


class TargetCurve(NamedTuple):
    """Position and rotation vector about the newest sample, as polynomials of degree 2 in the time since it."""

    time_ns: int
    """At which the polynomials' argument is 0, on the monotonic clock."""
    position: Vector
    velocity: Vector
    acceleration: Vector
    turn: Vector
    """Rotation vector in {s} from ``orientation``."""
    rate: Vector
    bend: Vector
    """Second derivative of the rotation vector."""
    orientation: Quaternion
    """Of the newest sample."""


class CurveParameter(NamedTuple):
    """Where on a curve, and how fast it is run through."""

    age_s: float
    """Argument of the polynomials."""
    time_rate: float = 1.0
    """d(age)/dt: 1 while time runs as it does."""
    time_rate_change: float = 0.0
    """Its derivative [1/s]."""


@compiled
def evaluate(curve: TargetCurve, moment: CurveParameter, turning: CurveParameter) -> RigidMotion:
    """The motion along ``curve``: the position's part at ``moment``, the orientation's at ``turning``."""
    position, velocity, acceleration = _polynomial(curve.position, curve.velocity, curve.acceleration, moment)
    turn, slope, bend = _polynomial(curve.turn, curve.rate, curve.bend, turning)
    orientation = multiply(from_rotation_vector(turn), curve.orientation)
    return RigidMotion(
        position, velocity, acceleration, orientation, _left_jacobian(turn, slope), _left_jacobian(turn, bend)
    )


@compiled
def resting(position: Vector, orientation: Quaternion) -> RigidMotion:
    """At rest at one pose."""
    return RigidMotion(position, ZERO, ZERO, orientation, ZERO, ZERO)


@compiled
def _polynomial(p: Vector, v: Vector, a: Vector, moment: CurveParameter) -> tuple[Vector, Vector, Vector]:
    t, time_rate, change = moment
    half = 0.5 * t
    value = (p[0] + t * (v[0] + half * a[0]), p[1] + t * (v[1] + half * a[1]), p[2] + t * (v[2] + half * a[2]))
    x, y, z = v[0] + t * a[0], v[1] + t * a[1], v[2] + t * a[2]
    squared = time_rate * time_rate
    return (
        value,
        (time_rate * x, time_rate * y, time_rate * z),
        (squared * a[0] + change * x, squared * a[1] + change * y, squared * a[2] + change * z),
    )


@compiled
def _left_jacobian(turn: Vector, slope: Vector) -> Vector:
    """J_l(turn) slope to first order: turns are those of a sample period, where the rest is below 1 %."""
    x, y, z = turn
    a, b, c = slope
    return (a + 0.5 * (y * c - z * b), b + 0.5 * (z * a - x * c), c + 0.5 * (x * b - y * a))

"""The curve on which a streamed target is extrapolated from its newest sample."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.jit import compiled
from ik_node.math.quaternion import ZERO, Quaternion, Vector, from_rotation_vector, multiply
from ik_node.targets.jerk_limited_filter import RigidMotion


class TargetCurve(NamedTuple):
    """Position and rotation vector about the newest sample, as polynomials of degree 2 in the time since it."""

    time_ns: int
    """Monotonic time at which the argument of the polynomials is 0."""
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
    """Argument of a curve, and its rates of change."""

    age_s: float
    """Argument of the polynomials."""
    time_rate: float = 1.0
    """d(age_s)/dt: 1 in undistorted time."""
    time_rate_change: float = 0.0
    """Its derivative [1/s]."""


@compiled
def evaluate(curve: TargetCurve, linear: CurveParameter, angular: CurveParameter) -> RigidMotion:
    """Evaluates a curve.

    Args:
        curve: The curve.
        linear: Parameter for the position.
        angular: Parameter for the orientation.

    Returns:
        Pose, velocity and acceleration in {s}.
    """
    position, velocity, acceleration = _polynomial(curve.position, curve.velocity, curve.acceleration, linear)
    turn, slope, bend = _polynomial(curve.turn, curve.rate, curve.bend, angular)
    orientation = multiply(from_rotation_vector(turn), curve.orientation)
    return RigidMotion(
        position, velocity, acceleration, orientation, _left_jacobian(turn, slope), _left_jacobian(turn, bend)
    )


@compiled
def resting(position: Vector, orientation: Quaternion) -> RigidMotion:
    """A motion at rest."""
    return RigidMotion(position, ZERO, ZERO, orientation, ZERO, ZERO)


@compiled
def _polynomial(p: Vector, v: Vector, a: Vector, parameter: CurveParameter) -> tuple[Vector, Vector, Vector]:
    t, time_rate, change = parameter
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
    """J_l(turn) slope to first order; for the turn of a sample period the remainder is below 1 %."""
    x, y, z = turn
    a, b, c = slope
    return (a + 0.5 * (y * c - z * b), b + 0.5 * (z * a - x * c), c + 0.5 * (x * b - y * a))

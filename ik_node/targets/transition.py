"""Transition of the reference onto another motion without a jump.

The reference is the motion and an offset from it ::

    p = p_m + d ,    R = E R_m

d and E start with the velocity and acceleration that make the reference continuous, and are led to zero by the bounded
cascade of :mod:`ik_node.targets.jerk_limited_filter`. So the velocity of the reference is continuous; onto a motion at
rest it moves straight and by the shortest turn; afterwards it is exactly on the motion.

Acceleration is continuous too, except for the part above the bounds at the start: the bounded jerk would end it only
slowly, and the arm would move on meanwhile. For the same reason a fast reference may brake harder than the bounds.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Vector,
    add,
    clamp_norm,
    conjugate,
    cross,
    difference,
    from_rotation_vector,
    length,
    multiply,
    normalised,
    rotate,
    scaled,
    to_rotation_vector,
)
from ik_node.math.types import Array
from ik_node.targets.bounds import bounds_from_rest
from ik_node.targets.jerk_limited_filter import (
    Bounds,
    Jerk,
    MotionBounds,
    RigidMotion,
    cascade_jerk,
    integrate,
    orientation_error,
)
from ik_node.targets.jerk_schedule import EMPTY_SCHEDULE, empty_schedule, executed, no_schedule, write_jerk
from ik_node.targets.stream.extrapolation import resting

OMEGA = 20.0
"""Triple pole of the cascade [1/s]."""
BRAKING_S = 0.15
"""The bounds on acceleration and jerk are raised until the velocity can end in this time ..."""
STRONGEST = 5.0
"""... but at most by this factor."""
MIN_TIME_RATE = 0.02
"""Smallest fraction of a control interval for which the twist of a slowed reference is computed."""
GONE = 1e-10
"""An offset is zero if all its numbers [m, rad] and its derivatives times 1 / OMEGA are below this."""


class Transition(NamedTuple):
    """Offset of the reference from the motion, with its derivatives; plain data."""

    motion: RigidMotion
    """d and E with their derivatives in {s}."""
    limits: MotionBounds
    turn: Vector = ZERO
    """Last orientation error [rad]."""
    schedule: Array = EMPTY_SCHEDULE
    """See :mod:`ik_node.targets.jerk_schedule`."""


NO_TRANSITION = Transition(
    RigidMotion(), MotionBounds(bounds_from_rest(1.0, 1.0, 1.0), bounds_from_rest(1.0, 1.0, 1.0))
)
"""Placeholder in compiled functions."""


def start_transition(reference: RigidMotion, motion: RigidMotion, limits: MotionBounds) -> Transition:
    """Starts a transition.

    Args:
        reference: Present reference.
        motion: The motion to reach.
        limits: Bounds of the offset.

    Returns:
        The transition, in which the position and velocity of the reference are continuous.
    """
    turn = normalised(multiply(reference.orientation, conjugate(motion.orientation)))
    rate = rotate(turn, motion.rate)
    change = add(rotate(turn, motion.angular_acceleration), cross(difference(reference.rate, rate), rate))
    transition = RigidMotion(
        difference(reference.position, motion.position),
        difference(reference.velocity, motion.velocity),
        difference(reference.acceleration, motion.acceleration),
        turn,
        difference(reference.rate, rate),
        difference(reference.angular_acceleration, change),
    )
    raised = strengthened(limits, transition)
    return Transition(within(transition, raised), raised)


def strengthened(limits: MotionBounds, motion: RigidMotion) -> MotionBounds:
    """``limits`` with acceleration and jerk raised so that ``motion`` can come to rest soon."""
    return MotionBounds(_stronger(limits.linear, motion.velocity), _stronger(limits.angular, motion.rate))


def _stronger(usual: Bounds, velocity: Vector) -> Bounds:
    factor = min(max(length(velocity) / (BRAKING_S * usual.acceleration), 1.0), STRONGEST)
    return usual._replace(acceleration=usual.acceleration * factor, jerk=usual.jerk * factor)


def within(motion: RigidMotion, limits: MotionBounds) -> RigidMotion:
    """``motion`` with its accelerations reduced to ``limits``."""
    return RigidMotion(
        motion.position,
        motion.velocity,
        clamp_norm(motion.acceleration, limits.linear.acceleration),
        motion.orientation,
        motion.rate,
        clamp_norm(motion.angular_acceleration, limits.angular.acceleration),
    )


def composed(motion: RigidMotion, transition: Transition | None) -> RigidMotion:
    """The reference, from the motion and its offset: the inverse of :func:`start_transition`."""
    if transition is None:
        return motion
    d = transition.motion
    rate = rotate(d.orientation, motion.rate)
    change = add(rotate(d.orientation, motion.angular_acceleration), cross(d.rate, rate))
    return RigidMotion(
        add(motion.position, d.position),
        add(motion.velocity, d.velocity),
        add(motion.acceleration, d.acceleration),
        normalised(multiply(d.orientation, motion.orientation)),
        add(rate, d.rate),
        add(change, d.angular_acceleration),
    )


@compiled
def placed(motion: RigidMotion, d: RigidMotion) -> RigidMotion:
    """The pose of the reference alone; the derivatives are zero."""
    turned = normalised(multiply(d.orientation, motion.orientation))
    return resting(add(motion.position, d.position), turned)


def advanced(transition: Transition, elapsed_s: float, time_rate: float) -> Transition | None:
    """The transition ``elapsed_s`` later, by its schedule first; None when the offset is zero.

    The offset changes by the fraction ``time_rate`` of that way, as the arm does.
    """
    if elapsed_s <= 0.0:
        return transition
    later, is_gone = _advanced(transition, elapsed_s, time_rate)
    return None if is_gone else later


@compiled
def _advanced(transition: Transition, elapsed_s: float, time_rate: float) -> tuple[Transition, bool]:
    turn = transition.turn
    motion, left_s = executed(transition.motion, transition.schedule, elapsed_s)
    if left_s > 1e-9:
        motion, turn, _ = _ahead(motion, turn, left_s, transition.limits)
    if time_rate < 1.0:
        motion = interpolated(transition.motion, motion, time_rate)
    return Transition(motion, transition.limits, turn, no_schedule()), _is_gone(motion)


@compiled
def planned(transition: Transition, hold_s: float) -> tuple[Transition, RigidMotion]:
    """The transition with its schedule for the next ``hold_s``, and the offset after it."""
    motion, turn, schedule = _ahead(transition.motion, transition.turn, hold_s, transition.limits)
    return Transition(transition.motion, transition.limits, turn, schedule), motion


def is_near(transition: Transition, distance_m: float, angle_rad: float) -> bool:
    """True if the offset is not larger than ``distance_m`` and ``angle_rad``."""
    d = transition.motion
    return length(d.position) <= distance_m and length(to_rotation_vector(d.orientation)) <= angle_rad


@compiled
def slowed(motion: RigidMotion, rate: float, change: float) -> RigidMotion:
    """``motion`` at ``rate`` times its speed, where ``rate`` changes by ``change`` per second."""
    squared = rate * rate
    return RigidMotion(
        motion.position,
        scaled(motion.velocity, rate),
        add(scaled(motion.acceleration, squared), scaled(motion.velocity, change)),
        motion.orientation,
        scaled(motion.rate, rate),
        add(scaled(motion.angular_acceleration, squared), scaled(motion.rate, change)),
    )


@compiled
def expected_time_rate(time_rate: float) -> float:
    """Expected executed fraction of the next twist; never 0, so that it has a direction."""
    return min(max(time_rate, MIN_TIME_RATE), 1.0)


@compiled
def interpolated(before: RigidMotion, after: RigidMotion, part: float) -> RigidMotion:
    """The derivatives of ``after`` at the fraction ``part`` of the way from ``before`` to ``after``."""
    way = scaled(difference(after.position, before.position), part)
    turn = scaled(to_rotation_vector(multiply(after.orientation, conjugate(before.orientation))), part)
    return RigidMotion(
        add(before.position, way),
        after.velocity,
        after.acceleration,
        normalised(multiply(from_rotation_vector(turn), before.orientation)),
        after.rate,
        after.angular_acceleration,
    )


@compiled
def _ahead(
    motion: RigidMotion, turn: Vector, duration_s: float, limits: MotionBounds
) -> tuple[RigidMotion, Vector, Array]:
    """The offset after ``duration_s`` of the cascade, its last orientation error, and the schedule of its jerks."""
    schedule = empty_schedule(duration_s)
    for row in schedule:
        step_s, way = row[6], scaled(motion.position, -1.0)
        turn = orientation_error(IDENTITY, motion.orientation, turn)
        linear = cascade_jerk(
            way, motion.velocity, motion.acceleration, ZERO, ZERO, OMEGA / 3.0, OMEGA, limits.linear, step_s
        )
        angular = cascade_jerk(
            turn, motion.rate, motion.angular_acceleration, ZERO, ZERO, OMEGA / 3.0, OMEGA, limits.angular, step_s
        )
        jerk = Jerk(linear, angular, step_s)
        write_jerk(row, jerk)
        motion = integrate(motion, jerk, step_s)
    return motion, turn, schedule


@compiled
def _is_gone(motion: RigidMotion) -> bool:
    _, x, y, z = motion.orientation
    return (
        _is_nothing(motion.position, 1.0)
        and _is_nothing(motion.velocity, 1.0 / OMEGA)
        and _is_nothing(motion.acceleration, 1.0 / OMEGA**2)
        and _is_nothing((x, y, z), 1.0)
        and _is_nothing(motion.rate, 1.0 / OMEGA)
        and _is_nothing(motion.angular_acceleration, 1.0 / OMEGA**2)
    )


@compiled
def _is_nothing(vector: Vector, factor: float) -> bool:
    x, y, z = scaled(vector, factor)
    return abs(x) < GONE and abs(y) < GONE and abs(z) < GONE

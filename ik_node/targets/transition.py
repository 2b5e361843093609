"""How the reference gets onto a motion that it is not on yet, without a jump.

The reference is the motion and an offset from it ::

    p = p_m + d ,    R = E R_m

d and E have velocity and acceleration of their own, taken over at the start so that the reference goes on as it was,
and are led to zero by the bounded third-order cascade of :mod:`ik_node.targets.jerk_limited_filter`. So the reference has a
continuous velocity; where the motion rests it gets there straight and by the shortest turn; then it is exactly on the
motion.

Acceleration is continuous too, but for what is above the bounds when an offset begins: carried on, it would have to be
ended by the bounded jerk, and the arm would run on meanwhile. For the same reason a reference that is fast at that
moment may brake harder than the bounds say.
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
"""Triple pole of the offset [1/s]."""
BRAKING_S = 0.15
"""The acceleration bound is raised, jerk with it, until it ends the velocity in this time ..."""
STRONGEST = 5.0
"""... but not to more than so many times itself."""
MIN_TIME_RATE = 0.02
"""A reference that is held up looks at least this part of an interval ahead."""
GONE = 1e-10
"""An offset whose every number is below this [m, rad, and per s and s2 times 1 / OMEGA] is none."""


class Transition(NamedTuple):
    """Where the reference is, seen from the motion; plain data."""

    motion: RigidMotion
    """d and E with their derivatives, all in {s}."""
    limits: MotionBounds
    turn: Vector = ZERO
    """Last error of orientation [rad]."""
    schedule: Array = EMPTY_SCHEDULE
    """As :mod:`ik_node.targets.jerk_schedule` says."""


NO_TRANSITION = Transition(
    RigidMotion(), MotionBounds(bounds_from_rest(1.0, 1.0, 1.0), bounds_from_rest(1.0, 1.0, 1.0))
)
"""Stands in for one in compiled functions."""


def start_transition(reference: RigidMotion, motion: RigidMotion, limits: MotionBounds) -> Transition:
    """The offset of ``reference`` from ``motion``, with its derivatives, to be led to zero within ``limits``."""
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
    """``limits`` with the acceleration that it takes to bring ``motion`` to rest soon."""
    return MotionBounds(_stronger(limits.linear, motion.velocity), _stronger(limits.angular, motion.rate))


def _stronger(usual: Bounds, velocity: Vector) -> Bounds:
    factor = min(max(length(velocity) / (BRAKING_S * usual.acceleration), 1.0), STRONGEST)
    return usual._replace(acceleration=usual.acceleration * factor, jerk=usual.jerk * factor)


def within(motion: RigidMotion, limits: MotionBounds) -> RigidMotion:
    """``motion`` with its accelerations cut to ``limits``."""
    return RigidMotion(
        motion.position,
        motion.velocity,
        clamp_norm(motion.acceleration, limits.linear.acceleration),
        motion.orientation,
        motion.rate,
        clamp_norm(motion.angular_acceleration, limits.angular.acceleration),
    )


def composed(motion: RigidMotion, transition: Transition | None) -> RigidMotion:
    """The reference at an offset from ``motion``: the opposite of :func:`start_transition`."""
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
    """The same for the pose alone; the derivatives are left at zero."""
    turned = normalised(multiply(d.orientation, motion.orientation))
    return resting(add(motion.position, d.position), turned)


def advanced(transition: Transition, elapsed_s: float, time_rate: float) -> Transition | None:
    """The offset ``elapsed_s`` later: as planned first, and on from there; None when it has become nothing.

    Only the part ``time_rate`` of its way is gone, as the arm does.
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
    """With the plan for the ``hold_s`` to come; and where it then will be."""
    motion, turn, schedule = _ahead(transition.motion, transition.turn, hold_s, transition.limits)
    return Transition(transition.motion, transition.limits, turn, schedule), motion


def is_near(transition: Transition, distance_m: float, angle_rad: float) -> bool:
    """Whether the offset is no larger than that."""
    d = transition.motion
    return length(d.position) <= distance_m and length(to_rotation_vector(d.orientation)) <= angle_rad


@compiled
def slowed(motion: RigidMotion, rate: float, change: float) -> RigidMotion:
    """``motion`` run through at ``rate`` times its speed, ``rate`` growing by ``change`` per second."""
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
    """The part of the next twist that the arm is likely to do, from the last one's; never nothing, so that a twist has
    a direction."""
    return min(max(time_rate, MIN_TIME_RATE), 1.0)


@compiled
def interpolated(before: RigidMotion, after: RigidMotion, part: float) -> RigidMotion:
    """``after``, with only ``part`` of the way from ``before`` to it gone."""
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
    """Where the cascade leads in ``duration_s``, its last error of orientation, and by which plan."""
    schedule = empty_schedule(duration_s)
    for row in schedule:
        step_s, way = row[6], scaled(motion.position, -1.0)
        turn = orientation_error(IDENTITY, motion.orientation, turn)
        linear = cascade_jerk(way, motion.velocity, motion.acceleration, ZERO, ZERO, OMEGA, limits.linear, step_s)
        angular = cascade_jerk(
            turn, motion.rate, motion.angular_acceleration, ZERO, ZERO, OMEGA, limits.angular, step_s
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

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
    conjugate,
    cross,
    cut,
    difference,
    from_vector,
    length,
    multiply,
    normalised,
    rotate,
    scaled,
    to_vector,
)
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import Bounds, Jerk, RigidMotion, chase, move, orientation_error
from ik_node.targets.jerk_schedule import NOTHING_PLANNED, carried_out, empty_plan, nothing_planned, write_jerk
from ik_node.targets.stream.extrapolation import resting

OMEGA = 20.0
"""Triple pole of the offset [1/s]."""
BRAKING_S = 0.15
"""The acceleration bound is raised, jerk with it, until it ends the velocity in this time ..."""
STRONGEST = 5.0
"""... but not to more than so many times itself."""
LEAST_PART = 0.02
"""A reference that is held up looks at least this part of an interval ahead."""
GONE = 1e-10
"""An offset whose every number is below this [m, rad, and per s and s2 times 1 / OMEGA] is none."""


class Limits(NamedTuple):
    """Bounds of an offset's two halves."""

    linear: Bounds
    angular: Bounds


def bounds(speed: float, acceleration: float, jerk: float) -> Bounds:
    """Bounds of one half, with all of its speed for the way to zero."""
    return Bounds(speed, acceleration, jerk, speed)


class Offset(NamedTuple):
    """Where the reference is, seen from the motion; plain data."""

    motion: RigidMotion
    """d and E with their derivatives, all in {s}."""
    limits: Limits
    turn: Vector = ZERO
    """Last error of orientation [rad]."""
    plan: Array = NOTHING_PLANNED
    """As :mod:`ik_node.targets.jerk_schedule` says."""


NO_OFFSET = Offset(RigidMotion(), Limits(bounds(1.0, 1.0, 1.0), bounds(1.0, 1.0, 1.0)))
"""Stands in for one in compiled functions."""


def between(reference: RigidMotion, motion: RigidMotion, limits: Limits) -> Offset:
    """The offset of ``reference`` from ``motion``, with its derivatives, to be led to zero within ``limits``."""
    turn = normalised(multiply(reference.orientation, conjugate(motion.orientation)))
    rate = rotate(turn, motion.rate)
    change = add(rotate(turn, motion.angular_acceleration), cross(difference(reference.rate, rate), rate))
    offset = RigidMotion(
        difference(reference.position, motion.position),
        difference(reference.velocity, motion.velocity),
        difference(reference.acceleration, motion.acceleration),
        turn,
        difference(reference.rate, rate),
        difference(reference.angular_acceleration, change),
    )
    raised = strengthened(limits, offset)
    return Offset(within(offset, raised), raised)


def strengthened(limits: Limits, motion: RigidMotion) -> Limits:
    """``limits`` with the acceleration that it takes to bring ``motion`` to rest soon."""
    return Limits(_stronger(limits.linear, motion.velocity), _stronger(limits.angular, motion.rate))


def _stronger(usual: Bounds, velocity: Vector) -> Bounds:
    factor = min(max(length(velocity) / (BRAKING_S * usual.acceleration), 1.0), STRONGEST)
    return usual._replace(acceleration=usual.acceleration * factor, jerk=usual.jerk * factor)


def within(motion: RigidMotion, limits: Limits) -> RigidMotion:
    """``motion`` with its accelerations cut to ``limits``."""
    return RigidMotion(
        motion.position,
        motion.velocity,
        cut(motion.acceleration, limits.linear.acceleration),
        motion.orientation,
        motion.rate,
        cut(motion.angular_acceleration, limits.angular.acceleration),
    )


def composed(motion: RigidMotion, offset: Offset | None) -> RigidMotion:
    """The reference at an offset from ``motion``: the opposite of :func:`between`."""
    if offset is None:
        return motion
    d = offset.motion
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


def advanced(offset: Offset, elapsed_s: float, pace: float) -> Offset | None:
    """The offset ``elapsed_s`` later: as planned first, and on from there; None when it has become nothing.

    Only the part ``pace`` of its way is gone, as the arm does.
    """
    if elapsed_s <= 0.0:
        return offset
    later, is_gone = _advanced(offset, elapsed_s, pace)
    return None if is_gone else later


@compiled
def _advanced(offset: Offset, elapsed_s: float, pace: float) -> tuple[Offset, bool]:
    turn = offset.turn
    motion, left_s = carried_out(offset.motion, offset.plan, elapsed_s)
    if left_s > 1e-9:
        motion, turn, _ = _ahead(motion, turn, left_s, offset.limits)
    if pace < 1.0:
        motion = part_of_way(offset.motion, motion, pace)
    return Offset(motion, offset.limits, turn, nothing_planned()), _is_gone(motion)


@compiled
def planned(offset: Offset, hold_s: float) -> tuple[Offset, RigidMotion]:
    """With the plan for the ``hold_s`` to come; and where it then will be."""
    motion, turn, plan = _ahead(offset.motion, offset.turn, hold_s, offset.limits)
    return Offset(offset.motion, offset.limits, turn, plan), motion


def is_near(offset: Offset, distance_m: float, angle_rad: float) -> bool:
    """Whether the offset is no larger than that."""
    d = offset.motion
    return length(d.position) <= distance_m and length(to_vector(d.orientation)) <= angle_rad


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
def likely_part(pace: float) -> float:
    """The part of the next twist that the arm is likely to do, from the last one's; never nothing, so that a twist has
    a direction."""
    return min(max(pace, LEAST_PART), 1.0)


@compiled
def part_of_way(before: RigidMotion, after: RigidMotion, part: float) -> RigidMotion:
    """``after``, with only ``part`` of the way from ``before`` to it gone."""
    way = scaled(difference(after.position, before.position), part)
    turn = scaled(to_vector(multiply(after.orientation, conjugate(before.orientation))), part)
    return RigidMotion(
        add(before.position, way),
        after.velocity,
        after.acceleration,
        normalised(multiply(from_vector(turn), before.orientation)),
        after.rate,
        after.angular_acceleration,
    )


@compiled
def _ahead(motion: RigidMotion, turn: Vector, duration_s: float, limits: Limits) -> tuple[RigidMotion, Vector, Array]:
    """Where the cascade leads in ``duration_s``, its last error of orientation, and by which plan."""
    plan = empty_plan(duration_s)
    for row in plan:
        step_s, way = row[6], scaled(motion.position, -1.0)
        turn = orientation_error(IDENTITY, motion.orientation, turn)
        linear = chase(way, motion.velocity, motion.acceleration, ZERO, ZERO, OMEGA, limits.linear, step_s)
        angular = chase(turn, motion.rate, motion.angular_acceleration, ZERO, ZERO, OMEGA, limits.angular, step_s)
        jerk = Jerk(linear, angular, step_s)
        write_jerk(row, jerk)
        motion = move(motion, jerk, step_s)
    return motion, turn, plan


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

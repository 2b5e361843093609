"""How the reference gets onto a motion that it is not on yet, without a jump.

The reference is the motion and an offset from it ::

    p = p_m + d ,    R = E R_m

d and E have velocity and acceleration of their own, taken over at the start so that the reference goes on as it was,
and are led to zero by the bounded third-order cascade of :mod:`ik_node.trajectory.reference`. So the reference has a
continuous velocity; where the motion rests it gets there straight and by the shortest turn; then it is exactly on the
motion.

Acceleration is continuous too, but for what is above the bounds when an offset begins: carried on, it would have to be
ended by the bounded jerk, and the arm would run on meanwhile. For the same reason a reference that is fast at that
moment may brake harder than the bounds say.
"""

from __future__ import annotations

from math import ceil
from typing import NamedTuple

from ik_node.trajectory.reference import Bounds, Jerk, RigidMotion, chase, move, orientation_error
from ik_node.trajectory.rotations import (
    IDENTITY,
    ZERO,
    Quaternion,
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

OMEGA = 20.0
"""Triple pole of the offset [1/s]."""
LONGEST_STEP_S = 0.004
"""A jerk is held no longer than this; longer intervals are cut."""
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
    plan: tuple[Jerk, ...] = ()
    """Jerks to come, as promised."""


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
    return motion._replace(
        acceleration=cut(motion.acceleration, limits.linear.acceleration),
        angular_acceleration=cut(motion.angular_acceleration, limits.angular.acceleration),
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


def placed(position: Vector, orientation: Quaternion, d: RigidMotion | None) -> RigidMotion:
    """The same for the pose alone; the derivatives are left at zero."""
    if d is None:
        return RigidMotion(position, orientation=orientation)
    turned = normalised(multiply(d.orientation, orientation))
    return RigidMotion(add(position, d.position), orientation=turned)


def advanced(offset: Offset, elapsed_s: float, pace: float) -> Offset | None:
    """The offset ``elapsed_s`` later: as planned first, and on from there; None when it has become nothing.

    Only the part ``pace`` of its way is gone, as the arm does.
    """
    if elapsed_s <= 0.0:
        return offset
    before, motion, turn, left_s = offset.motion, offset.motion, offset.turn, elapsed_s
    for jerk in offset.plan:
        part_s = min(jerk.duration_s, left_s)
        motion = move(motion, jerk, part_s)
        left_s -= part_s
        if left_s <= 0.0:
            break
    if left_s > 1e-9:
        motion, turn, _ = _ahead(motion, turn, left_s, offset.limits)
    if pace < 1.0:
        motion = part_of_way(before, motion, pace)
    return None if _is_gone(motion) else Offset(motion, offset.limits, turn)


def planned(offset: Offset, hold_s: float) -> tuple[Offset, RigidMotion]:
    """With the plan for the ``hold_s`` to come; and where it then will be."""
    motion, turn, plan = _ahead(offset.motion, offset.turn, hold_s, offset.limits)
    return Offset(offset.motion, offset.limits, turn, plan), motion


def is_near(offset: Offset, distance_m: float, angle_rad: float) -> bool:
    """Whether the offset is no larger than that."""
    d = offset.motion
    return length(d.position) <= distance_m and length(to_vector(d.orientation)) <= angle_rad


def slowed(motion: RigidMotion, rate: float, change: float) -> RigidMotion:
    """``motion`` run through at ``rate`` times its speed, ``rate`` growing by ``change`` per second."""
    squared = rate * rate
    return motion._replace(
        velocity=scaled(motion.velocity, rate),
        acceleration=add(scaled(motion.acceleration, squared), scaled(motion.velocity, change)),
        rate=scaled(motion.rate, rate),
        angular_acceleration=add(scaled(motion.angular_acceleration, squared), scaled(motion.rate, change)),
    )


def likely_part(pace: float) -> float:
    """The part of the next twist that the arm is likely to do, from the last one's; never nothing, so that a twist has
    a direction."""
    return min(max(pace, LEAST_PART), 1.0)


def part_of_way(before: RigidMotion, after: RigidMotion, part: float) -> RigidMotion:
    """``after``, with only ``part`` of the way from ``before`` to it gone."""
    way = scaled(difference(after.position, before.position), part)
    turn = scaled(to_vector(multiply(after.orientation, conjugate(before.orientation))), part)
    orientation = normalised(multiply(from_vector(turn), before.orientation))
    return after._replace(position=add(before.position, way), orientation=orientation)


def _ahead(
    motion: RigidMotion, turn: Vector, duration_s: float, limits: Limits
) -> tuple[RigidMotion, Vector, tuple[Jerk, ...]]:
    """Where the cascade leads in ``duration_s``, its last error of orientation, and by which jerks."""
    steps = max(1, ceil(duration_s / LONGEST_STEP_S - 1e-9))
    step_s = duration_s / steps
    plan = []
    for _ in range(steps):
        x, y, z = motion.position
        turn = orientation_error(IDENTITY, motion.orientation, turn)
        linear = chase((-x, -y, -z), motion.velocity, motion.acceleration, ZERO, ZERO, OMEGA, limits.linear, step_s)
        angular = chase(turn, motion.rate, motion.angular_acceleration, ZERO, ZERO, OMEGA, limits.angular, step_s)
        plan.append(Jerk(linear, angular, step_s))
        motion = move(motion, plan[-1], step_s)
    return motion, turn, tuple(plan)


def _is_gone(motion: RigidMotion) -> bool:
    _, x, y, z = motion.orientation
    values = (
        *motion.position,
        *scaled(motion.velocity, 1.0 / OMEGA),
        *scaled(motion.acceleration, 1.0 / OMEGA**2),
        *(x, y, z),
        *scaled(motion.rate, 1.0 / OMEGA),
        *scaled(motion.angular_acceleration, 1.0 / OMEGA**2),
    )
    return max(values) < GONE and min(values) > -GONE

"""Jogging: a twist that is sent again and again moves a reference pose, which the arm follows closed loop.

The velocity goes to what was sent by the bounded cascade of :mod:`ik_node.targets.jerk_limited_filter` without its error of
pose, so that acceleration is continuous; a turn alone leaves the reference point where it is. Twists are those of the
tool point, in the axes of a frame that stands still in {s} or in the tool. Without twists for the time-out, or with a
twist of zero, the reference comes to rest, and the arm with it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import NO_POSE, Motion
from ik_node.jit import compiled
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    cross,
    cut,
    difference,
    from_matrix,
    length,
    multiply,
    orientation_in,
    position_in,
    rotate,
    to_vector,
)
from ik_node.math.types import Array
from ik_node.settings.groups import JogSettings
from ik_node.targets.jerk_limited_filter import Jerk, RigidMotion, chase, mean_twist, move, pose_of
from ik_node.targets.jerk_schedule import NOTHING_PLANNED, carried_out, empty_plan, write_jerk
from ik_node.targets.transition import OMEGA, Limits, bounds, likely_part, part_of_way, slowed, strengthened, within

LONGEST_GAP_S = 0.25
"""Ticks that were missed for longer than this are not made up for."""


class TwistFrame(NamedTuple):
    """The axes in which a twist is written."""

    rotation: Array
    """(3, 3): seen from the tool when ``in_tool``, else from {s}."""
    in_tool: bool
    """They move with the tool."""


class Wish(NamedTuple):
    """The last twist that came."""

    velocity: Vector = ZERO
    """m/s, in {s} or in the tool."""
    rate: Vector = ZERO
    """rad/s."""
    in_tool: bool = False
    until_ns: int = 0
    """Until when it counts."""


class Drive(NamedTuple):
    """What the reference remembers from tick to tick."""

    time_ns: int = 0
    motion: RigidMotion = RigidMotion()
    plan: Array = NOTHING_PLANNED
    """As :mod:`ik_node.targets.jerk_schedule` says."""
    lead: Vector = ZERO
    """By how much the reference is ahead of the tool [m], in {s}."""
    lead_turn: Vector = ZERO
    """The same for the orientation [rad]."""
    pace: float = 1.0


class Leash(NamedTuple):
    """How far the reference may be ahead of the tool."""

    distance: float
    angle: float


@dataclass
class JogSnapshot:
    """Everything that is remembered. Values are immutable, so that a shallow copy is a snapshot."""

    drive: Drive = field(default_factory=Drive)
    wish: Wish = field(default_factory=Wish)
    cut: bool = False
    """The twist was cut to the highest speeds."""
    limits: Limits | None = None
    """What holds until a reference that was fast at the start has slowed down; None for the usual ones."""


class Jog:
    """Twists in, T_sd(t) and V_d(t) out. All times are monotonic nanoseconds."""

    def __init__(self, settings: JogSettings) -> None:
        self.configure(settings)
        self._state = JogSnapshot()

    def configure(self, settings: JogSettings) -> None:
        """Other settings from now on."""
        s = self._settings = settings
        self._limits = Limits(
            bounds(s.max_linear_speed, s.linear_acceleration, s.linear_jerk),
            bounds(s.max_angular_speed, s.angular_acceleration, s.angular_jerk),
        )
        self._leash = Leash(s.leash_distance, s.leash_angle)

    def capture(self) -> JogSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: JogSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)

    def begin(self, reference: RigidMotion, time_ns: int) -> None:
        """From now on; comes to rest from how ``reference`` moves until a twist comes."""
        raised = strengthened(self._limits, reference)
        self._state = JogSnapshot(Drive(time_ns, within(reference, raised)), limits=raised)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Goes on with the same twist from somewhere else."""
        s = self._state
        s.drive = Drive(time_ns, reference)
        s.limits = None

    def add(self, twist: Array, frame: TwistFrame, stamped: Stamped) -> None:
        """A checked twist (6,), linear part first, in the axes of ``frame``."""
        s = self._state
        turn = from_matrix(frame.rotation)
        x, y, z, a, b, c = twist.tolist()
        linear, angular = rotate(turn, (x, y, z)), rotate(turn, (a, b, c))
        velocity, rate = cut(linear, self._settings.max_linear_speed), cut(angular, self._settings.max_angular_speed)
        s.cut = velocity != linear or rate != angular
        until_ns = min(stamped.time_ns, stamped.received_ns) + round(self._settings.timeout_s * NS)
        s.wish = Wish(velocity, rate, frame.in_tool, until_ns)

    def advance(self, time_ns: int, hold_s: float, pace: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``pace``: the part of the last twist that the arm did; the reference goes no further. ``pose_sb``: where the
        tool is; the reference runs no further ahead of it than the leash.
        """
        s = self._state
        tool_sb = NO_POSE if pose_sb is None else np.ascontiguousarray(pose_sb)
        s.drive, motion, is_slow = _driven(
            s.drive, s.wish, s.limits or self._limits, self._limits, self._leash, time_ns, hold_s, pace, tool_sb
        )
        if is_slow:
            s.limits = None
        return motion

    @property
    def ended(self) -> bool:
        """No twist counts any more."""
        return self._state.drive.time_ns >= self._state.wish.until_ns

    @property
    def cut(self) -> bool:
        """The last twist was cut to the highest speeds."""
        return self._state.cut and not self.ended

    @property
    def leashed(self) -> bool:
        """The tool does not follow, and the reference waits for it."""
        drive, leash = self._state.drive, self._leash
        far = length(drive.lead) > leash.distance or length(drive.lead_turn) > leash.angle
        return far and not self.ended

    def motion(self) -> RigidMotion:
        """The reference now, as the arm follows it."""
        return slowed(self._state.drive.motion, self._state.drive.pace, 0.0)


@compiled
def _driven(
    before: Drive,
    wish: Wish,
    limits: Limits,
    usual: Limits,
    leash: Leash,
    time_ns: int,
    hold_s: float,
    pace: float,
    pose_sb: Array,
) -> tuple[Drive, Motion, bool]:
    """The drive at ``time_ns`` with its motion from then on; and whether the ``usual`` limits can take over.

    ``pose_sb`` full of NaN: the lead stays what it was.
    """
    now = _caught_up(before, wish, limits, leash, time_ns, pace)
    motion, lead, lead_turn = now.motion, now.lead, now.lead_turn
    is_slow = _is_slow(motion, usual)
    if not np.isnan(pose_sb[3, 3]):
        lead = difference(motion.position, position_in(pose_sb))
        lead_turn = to_vector(multiply(motion.orientation, conjugate(orientation_in(pose_sb))))
    now = Drive(now.time_ns, motion, now.plan, lead, lead_turn, pace)
    then, plan = _ahead(now, wish, usual if is_slow else limits, leash, hold_s)
    part = likely_part(pace)
    twist_d = mean_twist(motion, part_of_way(motion, then, part), part * hold_s)
    return Drive(now.time_ns, motion, plan, lead, lead_turn, pace), Motion(pose_of(motion), twist_d), is_slow


@compiled
def _caught_up(before: Drive, wish: Wish, limits: Limits, leash: Leash, time_ns: int, pace: float) -> Drive:
    """At ``time_ns``: as planned first, and on from there; only the part ``pace`` of the way."""
    if time_ns <= before.time_ns:
        return before
    elapsed_s = min((time_ns - before.time_ns) / NS, LONGEST_GAP_S)
    motion, left_s = carried_out(before.motion, before.plan, elapsed_s)
    now = Drive(time_ns, motion, before.plan, before.lead, before.lead_turn, before.pace)
    if left_s > 1e-9:
        motion, _ = _ahead(now, wish, limits, leash, left_s)
    if pace < 1.0:
        motion = part_of_way(before.motion, motion, pace)
    return Drive(time_ns, motion, before.plan, before.lead, before.lead_turn, before.pace)


@compiled
def _ahead(now: Drive, wish: Wish, limits: Limits, leash: Leash, duration_s: float) -> tuple[RigidMotion, Array]:
    """Where the cascade leads in ``duration_s``, and by which plan."""
    motion, plan = now.motion, empty_plan(duration_s)
    for row in plan:
        step_s = row[6]
        velocity, rate, change = _wanted(now, wish, leash, motion.orientation)
        linear = chase(ZERO, motion.velocity, motion.acceleration, velocity, change, OMEGA, limits.linear, step_s)
        angular = chase(ZERO, motion.rate, motion.angular_acceleration, rate, ZERO, OMEGA, limits.angular, step_s)
        jerk = Jerk(linear, angular, step_s)
        write_jerk(row, jerk)
        motion = move(motion, jerk, step_s)
    return motion, plan


@compiled
def _wanted(now: Drive, wish: Wish, leash: Leash, orientation: Quaternion) -> tuple[Vector, Vector, Vector]:
    """Velocity, angular velocity and the velocity's change that is due to the tool's turning, in {s}."""
    if now.time_ns >= wish.until_ns:
        return ZERO, ZERO, ZERO
    turn = orientation if wish.in_tool else IDENTITY
    velocity = _leashed(rotate(turn, wish.velocity), now.lead, leash.distance)
    rate = _leashed(rotate(turn, wish.rate), now.lead_turn, leash.angle)
    return velocity, rate, cross(rate, velocity) if wish.in_tool else ZERO


@compiled
def _is_slow(motion: RigidMotion, limits: Limits) -> bool:
    """Whether these limits can take over."""
    linear, angular = limits
    return (
        length(motion.velocity) <= linear.speed
        and length(motion.acceleration) <= linear.acceleration
        and length(motion.rate) <= angular.speed
        and length(motion.angular_acceleration) <= angular.acceleration
    )


@compiled
def _leashed(velocity: Vector, lead: Vector, leash: float) -> Vector:
    """``velocity`` without what would lead further away: all of it at twice the leash, nothing up to once."""
    size = length(lead)
    if size <= leash:
        return velocity
    x, y, z = lead
    away = (velocity[0] * x + velocity[1] * y + velocity[2] * z) / size
    if away <= 0.0:
        return velocity
    factor = min(size / leash - 1.0, 1.0) * away / size
    return (velocity[0] - factor * x, velocity[1] - factor * y, velocity[2] - factor * z)

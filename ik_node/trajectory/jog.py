"""Jogging: a twist that is sent again and again moves a reference pose, which the arm follows closed loop.

The velocity goes to what was sent by the bounded cascade of :mod:`ik_node.trajectory.reference` without its error of
pose, so that acceleration is continuous; a turn alone leaves the reference point where it is. Twists are those of the
tool point, in the axes of a frame that stands still in {s} or in the tool. Without twists for the time-out, or with a
twist of zero, the reference comes to rest, and the arm with it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import ceil
from typing import NamedTuple

from ik_node.clock import NS, Stamped
from ik_node.se3 import Array
from ik_node.settings import JogSettings
from ik_node.trajectory.motion import Motion
from ik_node.trajectory.offset import (
    LONGEST_STEP_S,
    OMEGA,
    Limits,
    bounds,
    likely_part,
    part_of_way,
    slowed,
    strengthened,
    within,
)
from ik_node.trajectory.reference import Jerk, RigidMotion, chase, mean_twist, move, pose_of
from ik_node.trajectory.rotations import (
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
    rotate,
    to_vector,
)

LONGEST_GAP_S = 0.25
"""Ticks that were missed for longer than this are not made up for."""


class TwistFrame(NamedTuple):
    """The axes in which a twist is written."""

    rotation: Array
    """(3, 3): seen from the tool when ``in_tool``, else from {s}."""
    in_tool: bool
    """They move with the tool."""


@dataclass
class JogState:
    """Everything that is remembered. Values are immutable, so that a shallow copy is a snapshot."""

    time_ns: int = 0
    motion: RigidMotion = field(default_factory=RigidMotion)
    plan: tuple[Jerk, ...] = ()
    velocity: Vector = ZERO
    """Wanted, m/s, in {s} or in the tool."""
    rate: Vector = ZERO
    """Wanted, rad/s."""
    in_tool: bool = False
    until_ns: int = 0
    """Until when the twist counts."""
    cut: bool = False
    """The twist was cut to the highest speeds."""
    lead: Vector = ZERO
    """By how much the reference is ahead of the tool [m], in {s}."""
    lead_turn: Vector = ZERO
    """The same for the orientation [rad]."""
    pace: float = 1.0
    limits: Limits | None = None
    """What holds until a reference that was fast at the start has slowed down; None for the usual ones."""


class Jog:
    """Twists in, T_sd(t) and V_d(t) out. All times are monotonic nanoseconds."""

    def __init__(self, settings: JogSettings) -> None:
        self.configure(settings)
        self._state = JogState()

    def configure(self, settings: JogSettings) -> None:
        """Other settings from now on."""
        s = self._settings = settings
        self._limits = Limits(
            bounds(s.max_linear_speed, s.linear_acceleration, s.linear_jerk),
            bounds(s.max_angular_speed, s.angular_acceleration, s.angular_jerk),
        )

    def state(self) -> JogState:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, state: JogState) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(state)

    def begin(self, reference: RigidMotion, time_ns: int) -> None:
        """From now on; comes to rest from how ``reference`` moves until a twist comes."""
        raised = strengthened(self._limits, reference)
        self._state = JogState(time_ns=time_ns, motion=within(reference, raised), limits=raised)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Goes on with the same twist from somewhere else."""
        s = self._state
        s.time_ns, s.motion, s.plan, s.lead, s.lead_turn, s.pace = time_ns, reference, (), ZERO, ZERO, 1.0
        s.limits = None

    def add(self, twist: Array, frame: TwistFrame, stamped: Stamped) -> None:
        """A checked twist (6,), linear part first, in the axes of ``frame``."""
        s = self._state
        turn = from_matrix(frame.rotation)
        x, y, z, a, b, c = twist.tolist()
        linear, angular = rotate(turn, (x, y, z)), rotate(turn, (a, b, c))
        s.velocity = cut(linear, self._settings.max_linear_speed)
        s.rate = cut(angular, self._settings.max_angular_speed)
        s.cut = s.velocity != linear or s.rate != angular
        s.in_tool = frame.in_tool
        s.until_ns = min(stamped.time_ns, stamped.received_ns) + round(self._settings.timeout_s * NS)

    def advance(self, time_ns: int, hold_s: float, pace: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``pace``: the part of the last twist that the arm did; the reference goes no further. ``pose_sb``: where the
        tool is; the reference runs no further ahead of it than the leash.
        """
        self._catch_up(time_ns, pace)
        s = self._state
        if s.limits is not None and self._is_slow(s.motion):
            s.limits = None
        if pose_sb is not None:
            x, y, z = pose_sb[:3, 3].tolist()
            s.lead = difference(s.motion.position, (x, y, z))
            s.lead_turn = to_vector(multiply(s.motion.orientation, conjugate(from_matrix(pose_sb))))
        motion, s.plan = self._ahead(s.motion, hold_s)
        part = likely_part(pace)
        return Motion(pose_of(s.motion), mean_twist(s.motion, part_of_way(s.motion, motion, part), part * hold_s))

    def _catch_up(self, time_ns: int, pace: float) -> None:
        s = self._state
        s.pace = pace
        if time_ns <= s.time_ns:
            return
        before, left_s = s.motion, min((time_ns - s.time_ns) / NS, LONGEST_GAP_S)
        for jerk in s.plan:
            part_s = min(jerk.duration_s, left_s)
            s.motion = move(s.motion, jerk, part_s)
            left_s -= part_s
            if left_s <= 0.0:
                break
        s.time_ns = time_ns
        if left_s > 1e-9:
            s.motion, _ = self._ahead(s.motion, left_s)
        if pace < 1.0:
            s.motion = part_of_way(before, s.motion, pace)

    def _ahead(self, motion: RigidMotion, duration_s: float) -> tuple[RigidMotion, tuple[Jerk, ...]]:
        steps = max(1, ceil(duration_s / LONGEST_STEP_S - 1e-9))
        step_s = duration_s / steps
        limits = self._state.limits or self._limits
        plan = []
        for _ in range(steps):
            velocity, rate, change = self._wanted(motion.orientation)
            linear = chase(ZERO, motion.velocity, motion.acceleration, velocity, change, OMEGA, limits.linear, step_s)
            angular = chase(ZERO, motion.rate, motion.angular_acceleration, rate, ZERO, OMEGA, limits.angular, step_s)
            plan.append(Jerk(linear, angular, step_s))
            motion = move(motion, plan[-1], step_s)
        return motion, tuple(plan)

    def _is_slow(self, motion: RigidMotion) -> bool:
        """Whether the usual limits can take over."""
        fast = length(motion.velocity) > self._limits.linear.speed or length(motion.rate) > self._limits.angular.speed
        return not fast and within(motion, self._limits) == motion

    def _wanted(self, orientation: Quaternion) -> tuple[Vector, Vector, Vector]:
        """Velocity, angular velocity and the velocity's change that is due to the tool's turning, in {s}."""
        s = self._state
        if s.time_ns >= s.until_ns:
            return ZERO, ZERO, ZERO
        turn = orientation if s.in_tool else IDENTITY
        velocity = _leashed(rotate(turn, s.velocity), s.lead, self._settings.leash_distance)
        rate = _leashed(rotate(turn, s.rate), s.lead_turn, self._settings.leash_angle)
        return velocity, rate, cross(rate, velocity) if s.in_tool else ZERO

    @property
    def ended(self) -> bool:
        """No twist counts any more."""
        return self._state.time_ns >= self._state.until_ns

    @property
    def cut(self) -> bool:
        """The last twist was cut to the highest speeds."""
        return self._state.cut and not self.ended

    @property
    def leashed(self) -> bool:
        """The tool does not follow, and the reference waits for it."""
        s = self._state
        settings = self._settings
        far = length(s.lead) > settings.leash_distance or length(s.lead_turn) > settings.leash_angle
        return far and not self.ended

    def motion(self) -> RigidMotion:
        """The reference now, as the arm follows it."""
        return slowed(self._state.motion, self._state.pace, 0.0)


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

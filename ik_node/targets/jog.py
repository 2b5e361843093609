"""Jogging: repeated twists move a reference pose, which the arm follows in closed loop.

The velocity of the reference approaches the commanded twist by the cascade of
:mod:`ik_node.targets.jerk_limited_filter` without its pose error, so that acceleration is continuous; a pure rotation
keeps the reference point in place. Twists are those of the tool point, in the axes of a frame that is fixed in {s} or
in the tool. After the time-out without twists, or with a zero twist, the reference comes to rest.
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
    clamp_norm,
    conjugate,
    cross,
    difference,
    from_matrix,
    length,
    multiply,
    pose_position,
    pose_quaternion,
    rotate,
    to_rotation_vector,
)
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.bounds import JOG, motion_bounds
from ik_node.targets.jerk_limited_filter import (
    Jerk,
    MotionBounds,
    RigidMotion,
    cascade_jerk,
    integrate,
    mean_twist,
    pose_matrix,
)
from ik_node.targets.jerk_schedule import EMPTY_SCHEDULE, empty_schedule, executed, write_jerk
from ik_node.targets.transition import OMEGA, expected_time_rate, interpolated, slowed, strengthened, within

LONGEST_GAP_S = 0.25
"""Longest gap between control steps that is made up for."""


class TwistFrame(NamedTuple):
    """Axes in which a twist is expressed."""

    rotation: Array
    """(3, 3), relative to the tool if ``in_tool``, else to {s}."""
    in_tool: bool
    """True if the axes move with the tool."""


class TwistCommand(NamedTuple):
    """The last twist."""

    velocity: Vector = ZERO
    """m/s, in {s} or in the tool."""
    rate: Vector = ZERO
    """rad/s."""
    in_tool: bool = False
    until_ns: int = 0
    """Monotonic time until which it is valid."""


class JogState(NamedTuple):
    """State of the reference between control steps."""

    time_ns: int = 0
    motion: RigidMotion = RigidMotion()
    schedule: Array = EMPTY_SCHEDULE
    """See :mod:`ik_node.targets.jerk_schedule`."""
    lead: Vector = ZERO
    """Position of the reference relative to the tool [m], in {s}."""
    lead_turn: Vector = ZERO
    """The same for the orientation [rad]."""
    time_rate: float = 1.0


class LeadLimit(NamedTuple):
    """Largest lead of the reference over the tool."""

    distance: float
    """[m]"""
    angle: float
    """[rad]"""


LEAD_LIMIT = LeadLimit(0.03, 0.15)
"""Beyond this lead the reference waits for the tool."""


@dataclass
class JogSnapshot:
    """State of :class:`Jog`; all values are immutable, so a shallow copy is a snapshot."""

    state: JogState = field(default_factory=JogState)
    command: TwistCommand = field(default_factory=TwistCommand)
    clamped: bool = False
    """True if the twist was reduced to the maximum speed."""
    limits: MotionBounds | None = None
    """Raised bounds until a reference that was fast at the start has slowed down; None for the default bounds."""


class Jog:
    """Twists in, T_sd(t) and V_d(t) out; times are monotonic nanoseconds."""

    def __init__(self, settings: Settings, lead_limit: LeadLimit = LEAD_LIMIT) -> None:
        """``lead_limit``: largest lead of the reference over the tool."""
        self._lead_limit = lead_limit
        self.configure(settings)
        self._state = JogSnapshot()

    def configure(self, settings: Settings) -> None:
        """Applies other settings."""
        self._timeout_ns = round(settings.jog.timeout_s * NS)
        self._limits = motion_bounds(settings.target, JOG)

    def capture(self) -> JogSnapshot:
        """A snapshot for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: JogSnapshot) -> None:
        """Continues from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)

    def begin(self, reference: RigidMotion, time_ns: int) -> None:
        """Starts with the motion ``reference``, which comes to rest unless a twist arrives."""
        raised = strengthened(self._limits, reference)
        self._state = JogSnapshot(JogState(time_ns, within(reference, raised)), limits=raised)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Continues with the same twist from another motion."""
        s = self._state
        s.state = JogState(time_ns, reference)
        s.limits = None

    def add(self, twist: Array, frame: TwistFrame, stamped: Stamped) -> None:
        """Sets the commanded twist.

        Args:
            twist: Checked twist (6,) of the tool point, linear part first.
            frame: Axes in which it is expressed.
            stamped: Its times.
        """
        s = self._state
        turn = from_matrix(frame.rotation)
        x, y, z, a, b, c = twist.tolist()
        linear, angular = rotate(turn, (x, y, z)), rotate(turn, (a, b, c))
        velocity, rate = clamp_norm(linear, self._limits.linear.speed), clamp_norm(angular, self._limits.angular.speed)
        s.clamped = velocity != linear or rate != angular
        until_ns = min(stamped.time_ns, stamped.received_ns) + self._timeout_ns
        s.command = TwistCommand(velocity, rate, frame.in_tool, until_ns)

    def advance(self, time_ns: int, hold_s: float, time_rate: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The desired motion at a control step.

        Args:
            time_ns: Monotonic time of the step.
            hold_s: Time for which the twist will be applied.
            time_rate: Fraction of the last twist that the arm executed; the reference advances by the same fraction.
            pose_sb: Measured T_sb (4, 4), for the lead limit; None for no limit.

        Returns:
            T_sd at ``time_ns`` and its mean body twist V_d over ``hold_s``.
        """
        s = self._state
        tool_sb = NO_POSE if pose_sb is None else np.ascontiguousarray(pose_sb)
        s.state, motion, is_slow = _advanced(
            s.state,
            s.command,
            s.limits or self._limits,
            self._limits,
            self._lead_limit,
            time_ns,
            hold_s,
            time_rate,
            tool_sb,
        )
        if is_slow:
            s.limits = None
        return motion

    @property
    def ended(self) -> bool:
        """True if no twist is valid."""
        return self._state.state.time_ns >= self._state.command.until_ns

    @property
    def clamped(self) -> bool:
        """True while the last twist is reduced to the maximum speed."""
        return self._state.clamped and not self.ended

    @property
    def lead_limited(self) -> bool:
        """True while the reference waits for a tool that does not follow."""
        state, lead_limit = self._state.state, self._lead_limit
        far = length(state.lead) > lead_limit.distance or length(state.lead_turn) > lead_limit.angle
        return far and not self.ended

    def motion(self) -> RigidMotion:
        """The reference at the last control step, slowed down as the arm is."""
        return slowed(self._state.state.motion, self._state.state.time_rate, 0.0)


@compiled
def _advanced(
    before: JogState,
    command: TwistCommand,
    limits: MotionBounds,
    default_limits: MotionBounds,
    lead_limit: LeadLimit,
    time_ns: int,
    hold_s: float,
    time_rate: float,
    pose_sb: Array,
) -> tuple[JogState, Motion, bool]:
    """The state and the motion at ``time_ns``, and whether ``default_limits`` can replace ``limits``.

    If ``pose_sb`` is NaN, the lead is kept.
    """
    now = _caught_up(before, command, limits, lead_limit, time_ns, time_rate)
    motion, lead, lead_turn = now.motion, now.lead, now.lead_turn
    is_slow = _is_slow(motion, default_limits)
    if not np.isnan(pose_sb[3, 3]):
        lead = difference(motion.position, pose_position(pose_sb))
        lead_turn = to_rotation_vector(multiply(motion.orientation, conjugate(pose_quaternion(pose_sb))))
    now = JogState(now.time_ns, motion, now.schedule, lead, lead_turn, time_rate)
    then, schedule = _ahead(now, command, default_limits if is_slow else limits, lead_limit, hold_s)
    part = expected_time_rate(time_rate)
    twist_d = mean_twist(motion, interpolated(motion, then, part), part * hold_s)
    return (
        JogState(now.time_ns, motion, schedule, lead, lead_turn, time_rate),
        Motion(pose_matrix(motion), twist_d),
        is_slow,
    )


@compiled
def _caught_up(
    before: JogState, command: TwistCommand, limits: MotionBounds, lead_limit: LeadLimit, time_ns: int, time_rate: float
) -> JogState:
    """The state at ``time_ns``: by the schedule, then by further steps; by the fraction ``time_rate`` of that way."""
    if time_ns <= before.time_ns:
        return before
    elapsed_s = min((time_ns - before.time_ns) / NS, LONGEST_GAP_S)
    motion, left_s = executed(before.motion, before.schedule, elapsed_s)
    now = JogState(time_ns, motion, before.schedule, before.lead, before.lead_turn, before.time_rate)
    if left_s > 1e-9:
        motion, _ = _ahead(now, command, limits, lead_limit, left_s)
    if time_rate < 1.0:
        motion = interpolated(before.motion, motion, time_rate)
    return JogState(time_ns, motion, before.schedule, before.lead, before.lead_turn, before.time_rate)


@compiled
def _ahead(
    now: JogState, command: TwistCommand, limits: MotionBounds, lead_limit: LeadLimit, duration_s: float
) -> tuple[RigidMotion, Array]:
    """The motion after ``duration_s`` of the cascade, and the schedule of its jerks."""
    motion, schedule = now.motion, empty_schedule(duration_s)
    for row in schedule:
        step_s = row[6]
        velocity, rate, change = _commanded(now, command, lead_limit, motion.orientation)
        linear = cascade_jerk(
            ZERO, motion.velocity, motion.acceleration, velocity, change, OMEGA / 3.0, OMEGA, limits.linear, step_s
        )
        angular = cascade_jerk(
            ZERO, motion.rate, motion.angular_acceleration, rate, ZERO, OMEGA / 3.0, OMEGA, limits.angular, step_s
        )
        jerk = Jerk(linear, angular, step_s)
        write_jerk(row, jerk)
        motion = integrate(motion, jerk, step_s)
    return motion, schedule


@compiled
def _commanded(
    now: JogState, command: TwistCommand, lead_limit: LeadLimit, orientation: Quaternion
) -> tuple[Vector, Vector, Vector]:
    """Commanded velocity, angular velocity, and acceleration due to the rotation of the tool, in {s}."""
    if now.time_ns >= command.until_ns:
        return ZERO, ZERO, ZERO
    turn = orientation if command.in_tool else IDENTITY
    velocity = _without_excess_lead(rotate(turn, command.velocity), now.lead, lead_limit.distance)
    rate = _without_excess_lead(rotate(turn, command.rate), now.lead_turn, lead_limit.angle)
    return velocity, rate, cross(rate, velocity) if command.in_tool else ZERO


@compiled
def _is_slow(motion: RigidMotion, limits: MotionBounds) -> bool:
    """True if the motion is within ``limits``."""
    linear, angular = limits
    return (
        length(motion.velocity) <= linear.speed
        and length(motion.acceleration) <= linear.acceleration
        and length(motion.rate) <= angular.speed
        and length(motion.angular_acceleration) <= angular.acceleration
    )


@compiled
def _without_excess_lead(velocity: Vector, lead: Vector, lead_limit: float) -> Vector:
    """``velocity`` without its component along ``lead``: removed fully at twice the limit, not at all up to once."""
    size = length(lead)
    if size <= lead_limit:
        return velocity
    x, y, z = lead
    away = (velocity[0] * x + velocity[1] * y + velocity[2] * z) / size
    if away <= 0.0:
        return velocity
    factor = min(size / lead_limit - 1.0, 1.0) * away / size
    return (velocity[0] - factor * x, velocity[1] - factor * y, velocity[2] - factor * z)


def twist_frame(robot: Robot, frames: Frames, frame: str) -> TwistFrame:
    """The present axes of a frame, for jogging.

    Args:
        robot: The robot.
        frames: Known frames with their poses.
        frame: Name of the frame.

    Returns:
        Axes relative to the tool if the frame moves with it, else to {s}.

    Raises:
        InputError: The frame is unknown; the message lists the known ones.
    """
    rotation = frames.pose(frame)[:3, :3]
    if frame in robot.frames and robot.moves_with_tool(frame) and frames.position is not None:
        return TwistFrame(robot.pose(frames.position)[:3, :3].T @ rotation, True)
    return TwistFrame(rotation, False)

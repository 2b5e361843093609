"""Measures commands against the limits in force, from the exact times of a recording."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.delivery import HOLD_UP_S
from ik_node.math.types import Array
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall, RecordedCalls
from ik_node.robot.joint_limits import MotionLimits, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

CONTROLLED = ("tracking", "holding", "ramping")


class Command(NamedTuple):
    """One command with the limits in force when it was given."""

    time_ns: int
    """Monotonic."""
    velocity: Array
    mode: str
    reason: str
    limits: MotionLimits
    period_s: float


class HoldUp(NamedTuple):
    """A time in which the node made no call: its machine did not run it."""

    begin_ns: int
    """Monotonic."""
    end_ns: int


class Measured(NamedTuple):
    """The columns of one row."""

    over: float
    not_finite: int
    acceleration: float
    zero_s: float | None
    """Time from the fault to the first zero command."""
    at_once: bool
    """True when that zero was not at the end of a ramp."""
    state_s: float | None
    """Time from the fault to the first Step with the expected mode and text."""


def read_commands(bag: Path, robot: Robot) -> list[Command]:
    """All commands of a recording, complete or cut off; none if its node was killed before the first was written."""
    try:
        calls = RecordedCalls(bag)
    except RecordingError:
        return []
    commands = []
    settings = calls.initial_settings
    limits = _limits(robot, settings)
    for entry in calls.entries():
        if not isinstance(entry, RecordedCall):
            continue
        if entry.call.kind is CallKind.APPLY:
            settings = calls.settings(entry)
            limits = _limits(robot, settings)
        if entry.step is not None:
            step = calls.steps.step(entry.step)
            period_s = 1.0 / settings.control.rate_hz
            status = step.status
            commands.append(
                Command(step.now.monotonic_ns, step.joint_velocity, status.mode.value, status.reason, limits, period_s)
            )
    return commands


def read_hold_ups(bag: Path) -> list[HoldUp]:
    """All hold-ups of a recording; none if it cannot be read."""
    try:
        entries = list(RecordedCalls(bag).entries())
    except RecordingError:
        return []
    times_ns = [entry.call.now.monotonic_ns for entry in entries if isinstance(entry, RecordedCall)]
    return [HoldUp(*pair) for pair in pairwise(times_ns) if pair[1] - pair[0] > HOLD_UP_S * NS]


def held_up_between(hold_ups: list[HoldUp], begin_ns: int, end_ns: int) -> float:
    """For how long hold-ups lasted in all between two monotonic times, s."""
    lengths_ns = (min(found.end_ns, end_ns) - max(found.begin_ns, begin_ns) for found in hold_ups)
    return sum(max(length_ns, 0) for length_ns in lengths_ns) / NS


def _limits(robot: Robot, settings: Settings) -> MotionLimits:
    return motion_limits(robot, settings.limits, settings.control.rate_hz)


def measure(commands: list[Command], begin_ns: int, fault_ns: int, end_ns: int, mode: str, text: str) -> Measured:
    """The columns of one fault.

    Args:
        commands: All commands of the node.
        begin_ns: Monotonic time before the fault.
        fault_ns: Monotonic time of the fault.
        end_ns: Monotonic time at which the arm was back in motion.
        mode: Expected mode.
        text: Part of the expected status text.
    """
    over = acceleration = 0.0
    zero_s: float | None = None
    state_s: float | None = None
    not_finite, at_once = 0, False
    rows = [command for command in commands if begin_ns <= command.time_ns <= end_ns]
    for before, command in pairwise(rows):
        not_finite += not np.isfinite(command.velocity).all()
        is_start = before.mode not in CONTROLLED
        elapsed_s = (command.time_ns - before.time_ns) * 1e-9
        elapsed_s = min(elapsed_s, command.period_s) if is_start else elapsed_s
        reach = command.limits.acceleration * elapsed_s
        # A lowered limit is in force once it has been reached within the acceleration limit. Of a longer interval the
        # controller uses dt_max_s.
        slowed = command.limits.acceleration * min(elapsed_s, command.limits.dt_max_s)
        in_force = np.maximum(command.limits.velocity, np.abs(before.velocity) - slowed)
        over = max(over, float(np.max(np.abs(command.velocity) / in_force)))
        stopped = not command.velocity.any() and command.mode not in CONTROLLED and before.velocity.any()
        change = float(np.max(np.abs(command.velocity - before.velocity) / np.maximum(reach, 1e-12)))
        if not (stopped and change > 1.0 + 1e-6 and before.mode != "ramping"):
            acceleration = max(acceleration, change)
        elif command.time_ns >= fault_ns:
            at_once = True
        after_s = (command.time_ns - fault_ns) * 1e-9
        if after_s < 0.0:
            continue
        zero_s = after_s if zero_s is None and not command.velocity.any() else zero_s
        is_expected = command.mode == mode and text in command.reason
        state_s = after_s if state_s is None and is_expected else state_s
    return Measured(over, not_finite, acceleration, zero_s, at_once, state_s)

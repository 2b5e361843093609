"""What would have been with other settings: recorded targets and obstacles, the loop closed in the simulator.

Every recorded call is made at its recorded time. Only joint states are not those of the recording: they keep their
times and names, and say where a simulated arm is that starts at the first recorded position and follows the commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from typing import NamedTuple

import numpy as np

from ik_node.control.controller import Controller
from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS, Instant, place
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Step
from ik_node.math.types import Array
from ik_node.messages.decode import decode_joint_state
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import Event
from ik_node.replay.call_source import Source, calls, make
from ik_node.robot.robot import JointLimits, Robot
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import Value


class Told(NamedTuple):
    """One call of a simulated run."""

    event: Event
    """As recorded."""
    sample: JointSample | None
    """The simulated joint state, where the call took one."""
    step: Step | None


class Simulated(NamedTuple):
    """A simulated run."""

    steps: list[Step]
    refused: int
    """Targets that the controller did not take."""


def simulate(source: Source, changes: Mapping[str, Value], each: Callable[[Told], None] | None = None) -> Simulated:
    """The Steps of a run with ``changes`` (parameter by full name -> value), from its start to its end.

    ``each`` is told every call. Raises SettingsError when a change is none, RecordingError when there is no joint state
    of every controlled joint.
    """
    controller = source.controller(source.begins_with.with_values(changes))
    arm = _Arm(controller, source)
    steps = []
    for event in calls(source):
        sample = None
        if event.call.kind is CallKind.ON_JOINT_STATE:
            sample = arm.measured(decode_joint_state(event.data), event.call.now)
            step = controller.on_joint_state(sample, event.call.now)
        else:
            step = make(controller, source, event, changes)
        if step is not None:
            arm.follow(step)
            steps.append(step)
        if each is not None:
            each(Told(event, sample, step))
    return Simulated(steps, controller.targets_refused)


def open_loop(source: Source, changes: Mapping[str, Value]) -> list[Step]:
    """The Steps that a controller with ``changes`` makes of the recorded joint states: its commands move nothing."""
    controller = source.controller(source.begins_with.with_values(changes))
    steps = (make(controller, source, event, changes) for event in calls(source))
    return [step for step in steps if step is not None]


def first_position(source: Source, robot: Robot, max_age_s: float) -> tuple[Array, int]:
    """Where the arm is first, (n,), rad (m), and since when, on the monotonic clock.

    ``max_age_s``: stamps older than this are not believed. RecordingError when there is no finite position of every
    controlled joint.
    """
    known: dict[str, float] = {}
    times: list[int] = []
    for event in calls(source):
        if event.call.kind is not CallKind.ON_JOINT_STATE:
            continue
        sample = decode_joint_state(event.data)
        for name, value in zip(sample.names, sample.position.tolist(), strict=False):
            if name in robot.joints and np.isfinite(value):
                known.setdefault(name, value)
                times.append(place(sample.stamp_ns, event.call.now, round(max_age_s * NS)).time_ns)
        if len(known) == robot.n:
            return np.array([known[name] for name in robot.joints]), times[0]
    missing = ", ".join(name for name in robot.joints if name not in known)
    raise RecordingError(f"the recording holds no position of {missing}")


class _Arm:
    """A simulated arm behind the recorded joint states' names and times."""

    def __init__(self, controller: Controller, source: Source) -> None:
        robot, max_age_s = controller.robot, controller.settings.state.max_age_s
        position, time_ns = first_position(source, robot, max_age_s)
        # A real arm may stand outside the limits of its model.
        lower, upper = np.minimum(robot.limits.lower, position), np.maximum(robot.limits.upper, position)
        self._arm = SimulatedArm(position, JointLimits(lower, upper, robot.limits.velocity), time_ns)
        self._arm.command(controller.capture().law.command.velocity, time_ns)
        self._joints = robot.joints
        self._places: dict[tuple[str, ...], list[tuple[int, int]]] = {}
        self._max_age_ns = round(max_age_s * NS)

    def measured(self, recorded: JointSample, now: Instant) -> JointSample:
        """The recorded joint state with the simulated positions; values that were not finite stay so."""
        measured, _ = self._arm.advance(place(recorded.stamp_ns, now, self._max_age_ns).time_ns)
        values, position = measured.tolist(), recorded.position.tolist()
        for theirs, ours in self._match(recorded.names[: len(position)]):
            if isfinite(position[theirs]):
                position[theirs] = values[ours]
        return JointSample(recorded.stamp_ns, recorded.names, np.array(position, dtype=np.float64))

    def _match(self, names: tuple[str, ...]) -> list[tuple[int, int]]:
        """Places in a message, and which of our joints each is of."""
        if names not in self._places:
            index = {name: number for number, name in enumerate(self._joints)}
            self._places[names] = [(theirs, index[name]) for theirs, name in enumerate(names) if name in index]
        return self._places[names]

    def follow(self, step: Step) -> None:
        """Takes the command of a step, when the step is made."""
        self._arm.command(step.joint_velocity, step.now.monotonic_ns)

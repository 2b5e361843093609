"""What-if simulation: recorded targets and obstacles, closed loop with a simulated arm, other settings.

Every recorded call is made at its recorded time. Only the positions in joint states are replaced: names and times stay,
and the positions are those of a simulated arm that starts at the first recorded position and follows the commands.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import NamedTuple

import numpy as np

from ik_node.control.controller import Controller
from ik_node.errors import IkNodeError, RecordingError
from ik_node.interfaces.clock import NS, Instant, to_monotonic
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Step
from ik_node.math.types import Array
from ik_node.messages.decode import SIMULATED_ARM, decode_joint_state
from ik_node.messages.encode import encode_joint_state
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall
from ik_node.replay.call_source import CallSource, argument_of, calls, make_recorded_call
from ik_node.replay.recorded_controller import RecordedController
from ik_node.robot.kinematics import JointLimits
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.settings.schema import Value
from ik_node.settings.task import TaskSettings


class SimulatedRun(NamedTuple):
    """Result of a simulated run."""

    steps: list[Step]
    refused: int
    """Number of targets that the controller refused."""
    tasks: list[TaskSettings]
    """What was followed at each step."""


def simulate(source: CallSource, changes: Mapping[str, Value]) -> SimulatedRun:
    """Simulates a run with other settings.

    Args:
        source: Recorded calls.
        changes: Parameter -> value.

    Returns:
        The Steps from start to end.

    Raises:
        SettingsError: A change is invalid.
        RecordingError: The recording lacks a joint state of a controlled joint.
    """
    controller = source.controller(source.initial_settings.with_values(changes))
    return close_loop(RecordedController(controller), source, changes)


def close_loop(
    recorded: RecordedController, source: CallSource, changes: Mapping[str, Value], model: ArmModel | None = None
) -> SimulatedRun:
    """As :func:`simulate`, on a controller of ``source`` with ``changes`` that may be recorded.

    ``model`` has lag and delay of the arm; default: ideal.
    """
    arm = _Arm(recorded.controller, source, model)
    steps, tasks = [], []
    for entry in calls(source):
        step = _simulated_call(recorded, source, entry, arm, changes)
        if step is not None:
            arm.command(step)
            steps.append(step)
            tasks.append(recorded.controller.settings.task)
    return SimulatedRun(steps, recorded.controller.targets_refused, tasks)


def _simulated_call(
    recorded: RecordedController, source: CallSource, entry: RecordedCall, arm: _Arm, changes: Mapping[str, Value]
) -> Step | None:
    (kind, _, now), data = entry.call, entry.data
    try:
        argument = argument_of(source, entry, changes)
        if kind is CallKind.ON_JOINT_STATE:
            argument = arm.measured(argument, now)
            if recorded.recording is not None and len(argument.names) == len(argument.position):
                data = encode_joint_state(argument.names, argument.stamp_ns, argument.position, frame_id=SIMULATED_ARM)
        return recorded.call(kind, now, argument, data)
    except IkNodeError:  # refused, as in the recorded run
        return None


def open_loop(source: CallSource, changes: Mapping[str, Value]) -> list[Step]:
    """The Steps of a controller with ``changes`` on the recorded joint states; its commands have no effect."""
    controller = source.controller(source.initial_settings.with_values(changes))
    steps = (make_recorded_call(controller, source, entry, changes) for entry in calls(source))
    return [step for step in steps if step is not None]


def first_position(source: CallSource, robot: Robot, max_stamp_age_s: float) -> tuple[Array, int]:
    """The initial position of the arm.

    Args:
        source: Recorded calls.
        robot: Robot of the run.
        max_stamp_age_s: Age beyond which a stamp is replaced by the time of arrival.

    Returns:
        Joint positions (n,), rad (m), and the monotonic time of the first one in ns.

    Raises:
        RecordingError: There is no finite position of a controlled joint.
    """
    positions: dict[str, float] = {}
    times: list[int] = []
    for entry in calls(source):
        if entry.call.kind is not CallKind.ON_JOINT_STATE:
            continue
        sample = decode_joint_state(entry.data)
        for name, value in zip(sample.names, sample.position.tolist(), strict=False):
            if name in robot.joints and np.isfinite(value):
                positions.setdefault(name, value)
                times.append(to_monotonic(sample.stamp_ns, entry.call.now, round(max_stamp_age_s * NS)).time_ns)
        if len(positions) == robot.n:
            return np.array([positions[name] for name in robot.joints]), times[0]
    missing = ", ".join(name for name in robot.joints if name not in positions)
    raise RecordingError(f"the recording contains no position of {missing}")


class _Arm:
    """A simulated arm that replaces the positions in recorded joint states."""

    def __init__(self, controller: Controller, source: CallSource, model: ArmModel | None) -> None:
        robot, max_age_s = controller.robot, controller.settings.state.max_stamp_age_s
        position, time_ns = first_position(source, robot, max_age_s)
        # A real arm may be outside the limits of its model.
        lower, upper = np.minimum(robot.limits.lower, position), np.maximum(robot.limits.upper, position)
        self._arm = SimulatedArm(position, JointLimits(lower, upper, robot.limits.velocity), time_ns, model)
        self._arm.command(controller.capture().velocity_controller.command.velocity, time_ns)
        self._joints = robot.joints
        self._indices: dict[tuple[str, ...], list[tuple[int, int]]] = {}
        self._max_age_ns = round(max_age_s * NS)

    def measured(self, recorded: JointSample, now: Instant) -> JointSample:
        """The recorded joint state with simulated positions; non-finite values are kept."""
        measured, _ = self._arm.advance(to_monotonic(recorded.stamp_ns, now, self._max_age_ns).time_ns)
        values, position = measured.tolist(), recorded.position.tolist()
        for index, joint in self._match(recorded.names[: len(position)]):
            if isfinite(position[index]):
                position[index] = values[joint]
        return JointSample(recorded.stamp_ns, recorded.names, np.array(position, dtype=np.float64))

    def _match(self, names: tuple[str, ...]) -> list[tuple[int, int]]:
        """Pairs of index in the message and index of the controlled joint."""
        if names not in self._indices:
            numbers = {name: number for number, name in enumerate(self._joints)}
            self._indices[names] = [(index, numbers[name]) for index, name in enumerate(names) if name in numbers]
        return self._indices[names]

    def command(self, step: Step) -> None:
        """Passes the command of a Step to the arm at the time of the Step."""
        self._arm.command(step.joint_velocity, step.now.monotonic_ns)

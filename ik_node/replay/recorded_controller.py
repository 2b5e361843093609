"""A controller with an optional recorder: makes a call, sends the Step, then records both.

The node, the real-time benchmark, the simulated runs and the tests drive the controller through it, so the order of the
entries in a recording (input message, call, Step, outputs, snapshot) is defined here only.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ik_node.control.controller import Controller
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Step
from ik_node.messages.encode import Outgoing
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import INPUTS, TEXT_CALLS
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.recording.run_recorder import RunRecording, RunSetup
from ik_node.replay.call_table import CALL_TABLE
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings


class RecordedController:
    """Calls a controller and records while a recording is open."""

    def __init__(
        self,
        controller: Controller,
        send: Callable[[Step], Sequence[Outgoing]] | None = None,
        recording: RunRecording | None = None,
        timer_ns: Callable[[], int] | None = None,
    ) -> None:
        """Keeps the arguments.

        Args:
            controller: What to call.
            send: Publishes a Step and returns the messages that were sent.
            recording: Where to record; default: nowhere, until :meth:`start`.
            timer_ns: Clock that measures the computing time of a Step, ns; default: it is not measured.
        """
        self.controller = controller
        self.recording = recording
        self._send = send
        self._timer_ns = timer_ns

    def start(
        self,
        directory: Path,
        node: str,
        now: Instant,
        topics: Mapping[str, str] | None = None,
        options: RecorderOptions | None = None,
        robot_name: str = "",
    ) -> RunRecording:
        """Starts a recording with the present state of the controller.

        Args:
            directory: New folder.
            node: Full name of the node.
            now: Time of the start.
            topics: Inputs and outputs -> ROS name, where it is not the default.
            options: How the files are written.
            robot_name: For the report; default: the parameter ``robot``.

        Returns:
            The recording, which is also :attr:`recording`.

        Raises:
            RecordingError: The folder exists or cannot be created.
        """
        controller = self.controller
        robot, settings = controller.robot, controller.settings
        setup = run_setup(node, robot, settings, topics, controller.capture(), controller.collision_monitor.digest)
        setup = setup._replace(methods=method_digests(controller))
        if robot_name:
            setup = setup._replace(robot_name=robot_name)
        self.recording = RunRecording(directory, setup, now, options)
        return self.recording

    def call(self, kind: CallKind, now: Instant, argument: Any = None, data: bytes = b"") -> Step | None:
        """Makes a call, sends the Step and records.

        Args:
            kind: What to call.
            now: Time of the call.
            argument: What the call takes: decoded message, text, :class:`Settings` or None.
            data: The message that ``argument`` was decoded from; used for the recording only.

        Returns:
            The Step that resulted from the call, or None.

        Raises:
            IkNodeError: The controller refused the argument. The call is recorded first, except refused settings.
        """
        begin_ns = 0 if self._timer_ns is None else self._timer_ns()
        try:
            step = CALL_TABLE[kind].call(self.controller, argument, now)
        except IkNodeError:
            if kind is not CallKind.APPLY:
                self._record(kind, now, argument, data)
            raise
        outputs = () if step is None or self._send is None else self._send(step)
        if self.recording is not None:
            computing_ns = 0 if self._timer_ns is None else self._timer_ns() - begin_ns
            self._record(kind, now, argument, data, step, outputs, computing_ns)
        return step

    def _record(
        self,
        kind: CallKind,
        now: Instant,
        argument: Any,
        data: bytes,
        step: Step | None = None,
        outputs: Sequence[Outgoing] = (),
        computing_ns: int = 0,
    ) -> None:
        recording = self.recording
        if recording is None:
            return
        if kind in INPUTS:
            recording.record_call(kind, now, recording.record_input(INPUTS[kind].name, data, now))
        elif kind is CallKind.APPLY:
            recording.record_settings(argument, now)
        else:
            recording.record_call(kind, now, text=str(argument) if kind in TEXT_CALLS else None)
        if step is not None:
            recording.record_step(step, outputs, computing_ns)
        recording.after_call(self.controller.capture, now)


def method_digests(controller: Controller) -> dict[str, str]:
    """The own methods of a controller: name -> digest of the source."""
    return {name: method.digest for name, method in controller.method.own.items()}


def run_setup(
    node: str,
    robot: Robot,
    settings: Settings,
    topics: Mapping[str, str] | None = None,
    snapshot: ControllerSnapshot | None = None,
    geometry: str = "",
) -> RunSetup:
    """Description of a run for its recording.

    Args:
        node: Full name of the node.
        robot: Robot of the controller.
        settings: Settings at the start.
        topics: Inputs and outputs -> ROS name, where it is not the default.
        snapshot: State of the controller at the start; None when it has not been called yet.
        geometry: Digest of the collision geometry.
    """
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz)
    return RunSetup(
        node=node,
        robot_name="" if settings.arm.robot_description else settings.arm.robot,
        urdf=robot.urdf,
        joints=robot.joints,
        base_frame=robot.base_frame,
        tip_frame=robot.tip_frame,
        limits={
            "lower": limits.lower,
            "upper": limits.upper,
            "velocity": limits.velocity,
            "acceleration": limits.acceleration,
        },
        settings=settings,
        topics=topics or {},
        snapshot=snapshot,
        geometry=geometry,
    )

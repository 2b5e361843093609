"""A controller whose calls are recorded as the node records them, to be put into a :class:`loop.Loop`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from loop import READY, Loop, make_robot

from ik_node.control.controller import Controller
from ik_node.errors import InputError, TargetRefused
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.samples import JointSample, PoseSample
from ik_node.interfaces.step import Step
from ik_node.messages import encode
from ik_node.messages.decode import decode_joint_state, decode_pose
from ik_node.messages.encode import Outgoing, StepOutputs
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import JOINT_STATES, TARGET_POSE
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.recording.run_recorder import RunRecording, RunSetup
from ik_node.settings.groups import Settings


class RecordedController:
    """Passes calls on to a controller, through the bytes that would have come over DDS, and records them."""

    def __init__(
        self, controller: Controller, directory: Path, now: Instant, options: RecorderOptions | None = None
    ) -> None:
        self.controller = controller
        robot = controller.robot
        setup = RunSetup("/ik_node", "panda", robot, controller.settings, {}, controller.capture(), controller.geometry)
        self.recording = RunRecording(directory, setup, now, options)
        self._outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)

    def on_joint_state(self, sample: JointSample, now: Instant) -> Step | None:
        stamp_ns = max(sample.stamp_ns, 0)
        data = encode.encode_joint_state(sample.names, stamp_ns, np.array(sample.position, dtype=np.float64))
        step = self.controller.on_joint_state(decode_joint_state(data), now)
        sequence = self.recording.received(JOINT_STATES, data, now)
        return self._told(CallKind.ON_JOINT_STATE, now, step, sequence)

    def on_target_pose(self, sample: PoseSample, now: Instant) -> None:
        data = encode.encode_pose(sample.frame_id, sample.stamp_ns, sample.position, sample.quaternion)
        try:
            self.controller.on_target_pose(decode_pose(data), now)
        except InputError as error:
            raise TargetRefused(str(error)) from error
        finally:
            self._told(CallKind.ON_TARGET_POSE, now, None, self.recording.received(TARGET_POSE, data, now))

    def on_clock(self, now: Instant) -> Step | None:
        return self._told(CallKind.ON_CLOCK, now, self.controller.on_clock(now))

    def pause(self, now: Instant, reason: str) -> None:
        self.controller.pause(now, reason)
        self._told(CallKind.PAUSE, now, text=reason)

    def on_transform(self, answer: str, now: Instant) -> None:
        self.controller.on_transform(answer, now)
        self._told(CallKind.ON_TRANSFORM, now, text=answer)

    def on_publishers(self, crowd: str, now: Instant) -> None:
        self.controller.on_publishers(crowd, now)
        self._told(CallKind.ON_PUBLISHERS, now, text=crowd)

    def resume(self, now: Instant) -> None:
        self.controller.resume()
        self._told(CallKind.RESUME, now)

    def reset(self, now: Instant) -> None:
        self.controller.reset()
        self._told(CallKind.RESET, now)

    def apply(self, settings: Settings, now: Instant) -> None:
        self.controller.apply(settings)
        self.recording.applied(settings, now)
        self.recording.between_calls(self.controller.state, now)

    def _told(
        self, kind: CallKind, now: Instant, step: Step | None = None, sequence: int = -1, text: str = ""
    ) -> Step | None:
        self.recording.called(kind, now, sequence, text)
        if step is not None:
            command = Outgoing(encode.COMMANDS, self._outputs.command(step))
            self.recording.sent(step, [command, *self._outputs.others(step)])
        self.recording.between_calls(self.controller.state, now)
        return step


def recorded_loop(
    directory: Path, values: dict[str, Any] | None = None, name: str = "panda", options: RecorderOptions | None = None
) -> Loop:
    """A loop of an arm at its ready posture, recorded from the start; ``values``: parameters."""
    loop = Loop(make_robot(name), READY[name], Settings().with_values(values or {}))
    record(loop, directory, options)
    return loop


def record(loop: Loop, directory: Path, options: RecorderOptions | None = None) -> None:
    """From now on the loop is recorded."""
    loop.controller = RecordedController(loop.controller, directory, loop.now, options)  # type: ignore[assignment]


def finish(loop: Loop) -> RunRecording:
    """Ends the recording; it must have gone well."""
    recording: RunRecording = loop.controller.recording  # type: ignore[attr-defined]
    recording.close()
    assert recording.error == ""
    return recording

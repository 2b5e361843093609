"""A controller whose calls are recorded as the node records them, for use in a :class:`loop.Loop`.

The file is written without a thread, every ``flush_period_s`` of simulated time. Chunk and part boundaries, and the
messages that a full queue drops, are therefore the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from loop import READY, Loop, make_robot

from ik_node.control.controller import Controller
from ik_node.errors import InputError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import JointSample, PoseSample
from ik_node.interfaces.step import Step
from ik_node.messages import encode
from ik_node.messages.decode import SIMULATED_ARM, decode_joint_state
from ik_node.messages.decode_targets import decode_pose
from ik_node.messages.step_codec import CallKind
from ik_node.messages.step_outputs import StepOutputs
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.recording.run_recorder import RunRecording
from ik_node.replay.recorded_controller import RecordedController
from ik_node.settings.groups import Settings


class RecordedCaller:
    """Has the methods of a controller; passes each call on through the bytes that DDS would deliver."""

    def __init__(
        self,
        controller: Controller,
        directory: Path,
        now: Instant,
        options: RecorderOptions | None = None,
        timer_ns: Callable[[], int] | None = None,
    ) -> None:
        self.controller = controller
        robot = controller.robot
        outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)
        self._options = (options or RecorderOptions())._replace(own_thread=False)
        self._due_ns = now.monotonic_ns
        self._calls = RecordedController(controller, outputs.messages, timer_ns=timer_ns)
        self.recording = self._calls.start(directory, "/ik_node", now, options=self._options, robot_name="panda")

    def __getattr__(self, name: str) -> Any:
        return getattr(self.controller, name)

    def on_joint_state(self, sample: JointSample, now: Instant) -> Step | None:
        stamp_ns = max(sample.stamp_ns, 0)
        position = np.array(sample.position, dtype=np.float64)
        data = encode.encode_joint_state(sample.names, stamp_ns, position, frame_id=SIMULATED_ARM)
        return self.call(CallKind.ON_JOINT_STATE, now, decode_joint_state(data), data)

    def on_target_pose(self, sample: PoseSample, now: Instant) -> None:
        data = encode.encode_pose(sample.frame_id, sample.stamp_ns, sample.position, sample.quaternion)
        try:
            self.call(CallKind.ON_TARGET_POSE, now, decode_pose(data), data)
        except InputError as error:
            raise TargetRefused(str(error)) from error

    def on_clock(self, now: Instant) -> Step | None:
        return self.call(CallKind.ON_CLOCK, now)

    def pause(self, now: Instant, reason: str) -> None:
        self.call(CallKind.PAUSE, now, reason)

    def on_transform(self, answer: str, now: Instant) -> None:
        self.call(CallKind.ON_TRANSFORM, now, answer)

    def on_input_note(self, text: str, now: Instant) -> None:
        self.call(CallKind.ON_INPUT_NOTE, now, text)

    def on_publishers(self, conflict: str, now: Instant) -> None:
        self.call(CallKind.ON_PUBLISHERS, now, conflict)

    def resume(self, now: Instant) -> None:
        self.call(CallKind.RESUME, now)

    def reset(self, now: Instant) -> None:
        self.call(CallKind.RESET, now)

    def apply(self, settings: Settings, now: Instant) -> None:
        self.call(CallKind.APPLY, now, settings)

    def call(self, kind: CallKind, now: Instant, argument: Any = None, data: bytes = b"") -> Step | None:
        """Write the file when it is due in simulated time, before the call rather than after it."""
        if now.monotonic_ns >= self._due_ns:
            self._due_ns = now.monotonic_ns + round(self._options.flush_period_s * NS)
            self.recording.write_pending()
        return self._calls.call(kind, now, argument, data)


def recorded_loop(
    directory: Path, values: dict[str, Any] | None = None, name: str = "panda", options: RecorderOptions | None = None
) -> Loop:
    """Return a loop of an arm at its ready posture, recorded from the start; ``values``: parameters."""
    loop = Loop(make_robot(name), READY[name], Settings().with_values(values or {}))
    record(loop, directory, options)
    return loop


def record(
    loop: Loop,
    directory: Path,
    options: RecorderOptions | None = None,
    timer_ns: Callable[[], int] | None = None,
) -> None:
    """Record the loop from now on; ``timer_ns``: clock of the computing times."""
    caller = RecordedCaller(loop.controller, directory, loop.now, options, timer_ns)
    # RecordedCaller has the methods of a Controller that a Loop calls, but is none.
    loop.controller = caller  # type: ignore[assignment]


def finish(loop: Loop) -> RunRecording:
    """End the recording; fail if it reported an error."""
    recording: RunRecording = loop.controller.recording  # type: ignore[attr-defined]
    recording.close()
    assert recording.error == ""
    return recording

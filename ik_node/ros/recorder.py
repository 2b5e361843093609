"""Recording of a node: nothing here stops or delays the control loop, and what goes wrong is said."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

from ik_node.control.controller import Controller
from ik_node.errors import RecordingError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Level, Status, Step
from ik_node.messages.encode import Outgoing
from ik_node.messages.step_codec import CallKind
from ik_node.recording.run_recorder import RunRecording, RunSetup, recorder_options
from ik_node.settings.groups import Settings


class NodeRecorder:
    """Begins and ends recordings of one node; between them every call does nothing."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._recording: RunRecording | None = None
        self._ended: list[RunRecording] = []
        self._failure = ""

    def start(self, controller: Controller, topics: dict[str, str], now: Instant) -> str:
        """Begins one and returns its folder; RecordingError when the folder exists or cannot be written.

        ``topics``: inputs and outputs -> ROS name.
        """
        if self._recording is None:
            settings = controller.settings
            name = self._node.get_fully_qualified_name()
            robot, state = controller.robot, controller.capture()
            setup = RunSetup(name, settings.arm.robot, robot, settings, topics, state, controller.geometry)
            usual = datetime.now().strftime("ik_node_%Y%m%d-%H%M%S")
            directory = Path(settings.recording.directory or usual)
            try:
                self._recording = RunRecording(directory, setup, now, recorder_options(settings.recording))
            except RecordingError as error:
                self._failure = str(error)
                raise
            self._failure = ""
            self._node.get_logger().info(f"recording to {directory}")
        return str(self._recording.directory)

    def end(self) -> str:
        """Ends it without waiting for the disk; returns what there is to say."""
        recording, self._recording = self._recording, None
        if recording is None:
            return "nothing was being recorded"
        recording.end()
        self._ended.append(recording)
        return _about(recording)

    def close(self) -> None:
        """Ends it, and waits until everything that was recorded is whole."""
        self.end()
        for recording in self._ended:
            recording.close()
            self._node.get_logger().info(_about(recording))
        self._ended = []

    # --- what happens ---

    def called(self, kind: CallKind, now: Instant, name: str = "", data: bytes = b"", text: str = "") -> None:
        """A call of the controller, and the message on the input ``name`` or the text that it took."""
        if self._recording is not None:
            sequence = self._recording.received(name, data, now) if name else -1
            self._recording.called(kind, now, sequence, text)

    def applied(self, settings: Settings, now: Instant) -> None:
        """The controller took over other settings."""
        if self._recording is not None:
            self._recording.applied(settings, now)

    def sent(self, step: Step, outgoing: Iterable[Outgoing]) -> None:
        """The Step that came of a call, and the messages that said it."""
        if self._recording is not None:
            self._recording.sent(step, outgoing)

    def said(self, message: Outgoing, now: Instant) -> None:
        """A message that went out beside the Steps."""
        if self._recording is not None:
            self._recording.said(message, now)

    def between_calls(self, controller: Controller, now: Instant) -> None:
        """All that a call led to has been told."""
        if self._recording is not None:
            self._recording.between_calls(controller.state, now)

    # --- what there is to say ---

    def remark(self, status: Status) -> Status:
        """``status``, and what is wrong with the recording: a warning, since the arm goes on."""
        wrong = self._failure if self._recording is None else self._recording.error
        if not wrong:
            return status
        level = status.level if status.level is Level.ERROR else Level.WARN
        return Status(level, status.mode, f"{status.reason}; {wrong}")

    def values(self) -> dict[str, str]:
        """For status and diagnostics."""
        if self._recording is None:
            return {}
        return {"recording": str(self._recording.directory), "recording_dropped": str(self._recording.dropped)}


def _about(recording: RunRecording) -> str:
    said = f"recorded {recording.directory}, {recording.dropped} messages left out"
    return f"{said}; {recording.error}" if recording.error else said

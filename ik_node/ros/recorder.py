"""Starts and ends recordings of the node. A failure is reported in the status and does not stop the control loop."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Status
from ik_node.messages.encode import Outgoing
from ik_node.recording.run_recorder import RunRecording, recorder_options
from ik_node.replay.recorded_controller import RecordedController


class NodeRecorder:
    """Starts and ends the recordings of one node."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._recording: RunRecording | None = None
        self._calls: RecordedController | None = None
        self._ended: list[RunRecording] = []
        self._failure = ""

    def start(self, calls: RecordedController, topics: dict[str, str], now: Instant) -> str:
        """Start a recording of the calls unless one is open already.

        Args:
            calls: The controller to be recorded.
            topics: Inputs and outputs -> ROS name.
            now: Time of the start.

        Returns:
            The folder.

        Raises:
            RecordingError: The folder exists or cannot be written.
        """
        if self._recording is None:
            settings = calls.controller.settings.recording
            directory = Path(settings.directory or datetime.now().strftime("ik_node_%Y%m%d-%H%M%S"))
            name = self._node.get_fully_qualified_name()
            try:
                self._recording = calls.start(directory, name, now, topics, recorder_options(settings))
            except RecordingError as error:
                self._failure = str(error)
                raise
            self._calls = calls
            self._failure = ""
            self._node.get_logger().info(f"recording to {directory}")
        return str(self._recording.directory)

    def end(self) -> str:
        """End the recording without waiting for the disk; return a summary."""
        recording, self._recording = self._recording, None
        if recording is None:
            return "no recording was open"
        if self._calls is not None:
            self._calls.recording = None
        recording.end()
        self._ended.append(recording)
        return _summary(recording)

    def close(self) -> None:
        """End the recording and wait until all files are complete."""
        self.end()
        for recording in self._ended:
            recording.close()
            self._node.get_logger().info(_summary(recording))
        self._ended = []

    def record(self, message: Outgoing, now: Instant) -> None:
        """Record a message that was published outside a Step: status or diagnostics."""
        if self._recording is not None:
            self._recording.record_output(message, now)

    def with_warning(self, status: Status) -> Status:
        """Return ``status``, at level WARN at least and with the reason when the recording has failed."""
        failure = self._failure if self._recording is None else self._recording.error
        return status.with_warning(failure)

    def values(self) -> dict[str, str]:
        """Return key-value pairs for the diagnostics."""
        if self._recording is None:
            return {}
        return {"recording": str(self._recording.directory), "recording_dropped": str(self._recording.dropped)}


def _summary(recording: RunRecording) -> str:
    summary = f"recorded {recording.directory}, {recording.dropped} messages dropped"
    return f"{summary}; {recording.error}" if recording.error else summary

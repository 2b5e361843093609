"""Controller, simulated arm and recording in one process in real time: duration and lateness of control steps."""

from __future__ import annotations

import gc
import time
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.control.controller import Controller
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Step
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages import decode, decode_targets, encode
from ik_node.messages.encode import Outgoing
from ik_node.messages.step_codec import CallKind
from ik_node.messages.step_outputs import StepOutputs
from ik_node.recording.mcap.metadata import Qos
from ik_node.recording.mcap.writer import Recorder, RecorderOptions
from ik_node.recording.run_recorder import RunRecording, RunSetup
from ik_node.replay.recorded_controller import RecordedController, run_setup
from ik_node.robot import catalogue
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

START = np.array((0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398))
TARGET_RATE_HZ = 50.0
BUSY_WAIT_S = 2e-4
"""Part of each wait that is a busy loop, because sleep is not exact."""


class StepTimes(NamedTuple):
    """Times of every control step, us."""

    tick: Array
    """From the bytes of the joint state to the bytes of all messages."""
    cycle: Array
    """The same including recording."""
    late: Array
    """Delay of the start."""


class RealTimeLoop:
    """A Panda on a figure of eight; every :meth:`run` continues the motion."""

    def __init__(self, rate_hz: float) -> None:
        self.settings = Settings().with_values({"rate_hz": rate_hz, "robot": "panda"})
        self.robot = catalogue.robot_from_settings(self.settings.arm)
        self.controller = Controller(self.robot, self.settings)
        self._period_ns = round(NS / rate_hz)
        self._arm = SimulatedArm(START, self.robot.limits, time.monotonic_ns())
        self._outputs = StepOutputs(self.robot.joints, self.robot.base_frame, self.robot.tip_frame)
        self._calls = RecordedController(self.controller, self._send)
        self._sent_ns = 0
        self._trajectory = figure_of_eight(self.robot.pose(START))
        self._since_ns = time.monotonic_ns()
        self._targets = 0

    def setup(self) -> RunSetup:
        """Description of the run for a recording that starts now."""
        controller = self.controller
        return run_setup(
            "/ik_node", self.robot, self.settings, {}, controller.capture(), controller.collision_monitor.digest
        )

    def now(self) -> Instant:
        """Read the clocks."""
        return Instant(time.monotonic_ns(), time.time_ns())

    def run(self, duration_s: float, recording: RunRecording | None) -> StepTimes:
        """Run control steps at the rate for ``duration_s``."""
        count = max(1, round(duration_s * NS / self._period_ns))
        tick, cycle, late = np.empty(count), np.empty(count), np.empty(count)
        self._calls.recording = recording
        gc.collect()
        gc.disable()
        due_ns = time.monotonic_ns() + self._period_ns
        try:
            for index in range(count):
                _wait_until(due_ns)
                late[index] = (time.monotonic_ns() - due_ns) / 1e3
                tick[index], cycle[index] = self._cycle()
                due_ns = max(due_ns + self._period_ns, time.monotonic_ns())
        finally:
            gc.enable()
        return StepTimes(tick, cycle, late)

    def _cycle(self) -> tuple[float, float]:
        now = self.now()
        self._send_target(now)
        position, velocity = self._arm.advance(now.monotonic_ns)
        data = encode.encode_joint_state(self.robot.joints, now.ros_ns, position, velocity)
        self._sent_ns = 0
        begin_ns = time.perf_counter_ns()
        self._calls.call(CallKind.ON_JOINT_STATE, now, decode.decode_joint_state(data), data)
        end_ns = time.perf_counter_ns()
        return ((self._sent_ns or end_ns) - begin_ns) / 1e3, (end_ns - begin_ns) / 1e3

    def _send(self, step: Step) -> list[Outgoing]:
        """Pass the command to the arm and encode the other messages."""
        command = Outgoing(encode.COMMANDS, self._outputs.command(step))
        self._arm.command(step.joint_velocity, step.now.monotonic_ns)
        outgoing = [command, *self._outputs.others(step)]
        self._sent_ns = time.perf_counter_ns()
        return outgoing

    def _send_target(self, now: Instant) -> None:
        elapsed_s = (now.monotonic_ns - self._since_ns) / NS
        if elapsed_s * TARGET_RATE_HZ < self._targets:
            return
        self._targets = int(elapsed_s * TARGET_RATE_HZ) + 1
        pose = self._trajectory.pose(elapsed_s % self._trajectory.duration_s)
        quaternion = se3.quaternion_from_rotation(pose[:3, :3])
        data = encode.encode_pose(self.robot.base_frame, now.ros_ns, pose[:3, 3], quaternion)
        self._calls.call(CallKind.ON_TARGET_POSE, now, decode_targets.decode_pose(data), data)


def _wait_until(due_ns: int) -> None:
    left_s = (due_ns - time.monotonic_ns()) / NS
    if left_s > BUSY_WAIT_S:
        time.sleep(left_s - BUSY_WAIT_S)
    while time.monotonic_ns() < due_ns:
        pass


# --- a process instead of a thread -----------------------------------------------------------------------------------


class ProcessRecorder:
    """A :class:`ik_node.recording.mcap.writer.Recorder` whose file is written by another process behind a pipe.

    For comparison with the thread. It does not split, and counts only messages that the pipe did not accept.
    """

    BATCH = 16
    """Messages per transfer through the pipe."""

    def __init__(self, directory: Path, options: RecorderOptions | None, custom: dict[str, str]) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_write_in_process, args=(theirs, directory, options, custom), daemon=True
        )
        self._process.start()
        self._pipe.recv()
        self._batch: list[tuple[int, bytes, int, int, int]] = []
        self._channels = 0
        self.directory = directory
        self.dropped = 0
        self.error = ""
        self.split_due = False

    def channel(self, topic: str, type_name: str, qos: Qos | None = None) -> int:
        """As in :class:`Recorder`."""
        self._pipe.send((topic, type_name, qos))
        self._channels += 1
        return self._channels

    def write(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int = 0, sequence: int = 0) -> bool:
        """As in :class:`Recorder`."""
        self._batch.append((channel, data, log_time_ns, publish_time_ns, sequence))
        if len(self._batch) >= self.BATCH:
            self._pipe.send(self._batch)
            self._batch = []
        return True

    def split(self) -> None:
        """Do nothing."""

    def end(self) -> None:
        """As in :class:`Recorder`, without waiting."""
        self.close()

    def close(self) -> None:
        """As in :class:`Recorder`."""
        if self._process.is_alive():
            self._pipe.send(self._batch)
            self._pipe.send(None)
            self._process.join(20.0)


def _write_in_process(
    pipe: Connection, directory: Path, options: RecorderOptions | None, custom: dict[str, str]
) -> None:
    recorder = Recorder(directory, options, custom)
    pipe.send("ready")
    while (got := pipe.recv()) is not None:
        if isinstance(got, tuple):
            recorder.channel(*got)
        else:
            for entry in got:
                recorder.write(*entry)
    recorder.close()


class ProcessRecording(RunRecording):
    """A run recorded by another process."""

    def _make_recorder(self, directory: Path, options: RecorderOptions | None, custom: dict[str, str]) -> Any:
        return ProcessRecorder(directory, options, custom)

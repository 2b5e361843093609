"""The demonstration: node and simulated arm as processes, a streamed trajectory, the recording, the report."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from shutil import which
from types import FrameType

import numpy as np
import rclpy
import yaml
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ik_node.control.warm_up import warm_up
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.jit import compilation_reports, is_cold
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.report import (
    GROUND_TRUTH_FILE,
    GroundTruth,
    as_json,
    as_text,
    compute_metrics,
    ground_truth_from_trajectory,
    write_ground_truth,
)
from ik_node.report.recorded_scene import read_obstacles
from ik_node.report.summary_page import save_summary
from ik_node.robot.simulator_parameters import SIMULATOR
from ik_node.ros.child_process import NodeProcess
from ik_node.ros.demo.new_folder import new_folder
from ik_node.ros.demo.options import CheckedRun, DemoOptions
from ik_node.ros.demo.target_streamer import TargetStreamer
from ik_node.settings.groups import Settings
from ik_node.trajectory import shapes
from ik_node.trajectory.pose_file import PoseFileTrajectory

READY_TIMEOUT_S = 120.0
"""Includes the compilation by the node where machine code cannot be stored on disk."""
STREAM_RATE_HZ = 50.0
HOLD_S = 0.6
"""Time after the last target; the node detects the end of the stream in it."""
PROGRESS_S = 0.2

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


class InterruptedBeforeStart(IkNodeError):
    """Ctrl-C before the motion began."""


class Demonstration:
    """One run from start to report."""

    def __init__(self, options: DemoOptions) -> None:
        """Read and check all files; raises an IkNodeError when one of them, or the output folder, is not usable."""
        self._options = options
        self._run = CheckedRun(options)
        self._robot = self._run.robot
        self._interrupted = False

    def run(self) -> int:
        """Run; return 0, or 130 when interrupted.

        After the start of the motion the recording is complete and reported in both cases. A run that fails leaves
        nothing behind.
        """
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._on_signal)
        try:
            with new_folder(self._run.out) as out:
                if is_cold():
                    with compilation_reports(functools.partial(print, flush=True)):
                        warm_up(self._robot, Settings())
                rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
                try:
                    with self._simulator(out) as simulator, self._node(out) as node:
                        truth = self._watched([simulator, node])
                finally:
                    rclpy.try_shutdown()
                self._report(out, truth)
        except InterruptedBeforeStart as error:
            print(f"{error}; nothing was recorded", flush=True)
            return INTERRUPTED
        return INTERRUPTED if self._interrupted else 0

    # --- processes ---------------------------------------------------------------------------------------------------

    def _simulator(self, out: Path) -> NodeProcess:
        file = out / f"{SIMULATOR}.yaml"
        values = {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in self._run.simulator.items()
            if value not in ("", ())
        }
        file.write_text(yaml.safe_dump({"/**": {SIMULATOR: {"ros__parameters": values}}}, sort_keys=False))
        return NodeProcess("ik_node.cli.simulator", ["--params-file", str(file)], {}, out / f"{SIMULATOR}.log")

    def _node(self, out: Path) -> NodeProcess:
        arguments = []
        if config := self._run.config:
            file = config.path
            if config.text:
                file = out / config.path.name
                file.write_text(config.text)
            arguments += ["--params-file", str(file)]
        if self._run.settings.arm.robot:
            arguments += ["-p", f"ik_node:robot:={self._run.settings.arm.robot}"]
        for value in ("recording.enabled:=true", f"recording.directory:={json.dumps(str(out / 'bag'))}"):
            arguments += ["-p", f"ik_node:{value}"]
        for name, value in self._options.overrides.items():
            arguments += ["-p", f"ik_node:{name}:={value}"]
        return NodeProcess("ik_node.cli.node", arguments, {}, out / "ik_node.log")

    def _watched(self, processes: list[NodeProcess]) -> GroundTruth:
        """Stream; print the ends of the logs, which are removed, when that fails."""
        try:
            return self._stream(processes)
        except InterruptedBeforeStart:
            raise
        except IkNodeError:
            for process in processes:
                print(f"end of {process.log.name}:\n{process.log_tail()}", file=sys.stderr)
            raise

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._interrupted = True

    # --- streaming ---------------------------------------------------------------------------------------------------

    def _stream(self, processes: list[NodeProcess]) -> GroundTruth:
        executor = EventsExecutor()
        streamer = TargetStreamer(self._robot, executor)

        def check_processes() -> None:
            for process in processes:
                if process.exit_code is not None:
                    raise IkNodeError(f"{process.module} ended with code {process.exit_code}; its log is above")

        def check_before_start() -> None:
            check_processes()
            if self._interrupted:
                raise InterruptedBeforeStart("interrupted before the start")

        print(f"starting {self._run.robot_name}: ik_node and ik_simulator over DDS", flush=True)
        if self._run.start is not None:
            print(self._run.start.describe(self._robot.joints), flush=True)
        streamer.wait_until_ready(READY_TIMEOUT_S, check_before_start)
        start_pose = streamer.measured_pose()
        trajectory = self._trajectory(start_pose)
        approach = shapes.straight_line(start_pose, trajectory.pose(0.0))
        whole = shapes.sequence(approach, trajectory)
        if approach.duration_s:
            print(f"{approach.duration_s:.1f} s approach to the first pose, then the trajectory", flush=True)

        def may_continue() -> bool:
            if not self._interrupted:
                check_processes()
            return not self._interrupted

        progress = Progress(streamer, whole, may_continue)
        start_ros_ns = streamer.stream(self._targets(approach, trajectory), progress)
        if not self._interrupted:
            streamer.spin_for(HOLD_S)
        progress.close()
        executor.shutdown(0.5)
        streamer.destroy_node()
        return ground_truth_from_trajectory(trajectory, start_ros_ns + round(approach.duration_s * NS))

    def _trajectory(self, start_pose: Array) -> Trajectory:
        if self._run.poses is None:
            return shapes.SHAPES[self._options.trajectory](start_pose)
        loaded = self._run.poses.trajectory(start_pose)
        print(loaded.describe(), flush=True)
        return loaded

    def _targets(self, approach: Trajectory, trajectory: Trajectory) -> Iterator[tuple[float, Array]]:
        """Yield (time_s, T_sd): a file at its own times unless a rate is given, otherwise at a constant rate."""
        rate_hz = self._options.target_rate_hz
        begin_s = approach.duration_s
        for time_s in _sample_times(begin_s, rate_hz or STREAM_RATE_HZ):
            if time_s < begin_s:
                yield time_s, approach.pose(time_s)
        if rate_hz is None and isinstance(trajectory, PoseFileTrajectory):
            for sample in trajectory.samples():
                yield begin_s + sample.time_s, sample.pose
            return
        for time_s in _sample_times(trajectory.duration_s, rate_hz or STREAM_RATE_HZ):
            yield begin_s + time_s, trajectory.pose(time_s)

    # --- the report ------------------------------------------------------------------------------------------------

    def _report(self, out: Path, truth: GroundTruth) -> None:
        write_ground_truth(out / GROUND_TRUTH_FILE, truth)
        run = load_run(out / "bag")
        report = compute_metrics(run, truth, self._trajectory_name(), obstacles=read_obstacles(out / "bag"))
        picture = out / "report.png"
        save_summary(run, report, picture)
        (out / "report.json").write_text(as_json(report))
        print(as_text(report))
        print(f"recording {out / 'bag'}\npicture   {picture}\nlook at it: ik_view {out / 'bag'}", flush=True)
        if self._options.show and sys.stdout.isatty() and which("xdg-open"):
            subprocess.Popen(["xdg-open", str(picture)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _trajectory_name(self) -> str:
        name = self._options.trajectory
        return name if name in shapes.SHAPES else Path(name).name


class Progress:
    """A progress line: rewritten ten times per second on a terminal, printed every two seconds elsewhere."""

    def __init__(self, streamer: TargetStreamer, whole: Trajectory, may_continue: Callable[[], bool]) -> None:
        self._streamer = streamer
        self._whole = whole
        self._may_continue = may_continue
        self._on_terminal = sys.stdout.isatty()
        self._every_s = 0.1 if self._on_terminal else 2.0
        self._next_s = 0.0

    def __call__(self, time_s: float) -> bool:
        """Print the progress at ``time_s``; return False when the run has to end."""
        if time_s >= self._next_s:
            self._next_s = time_s + self._every_s
            distance = self._streamer.measured_pose()[:3, 3] - self._whole.pose(time_s)[:3, 3]
            mode, reason = self._streamer.status
            line = f"{time_s:6.1f} / {self._whole.duration_s:.1f} s  error {1e3 * np.linalg.norm(distance):6.2f} mm"
            line += f"  {mode}: {reason}"
            print(
                f"\r{line:<100.100}" if self._on_terminal else line, end="" if self._on_terminal else "\n", flush=True
            )
        return self._may_continue()

    def close(self) -> None:
        """End the line."""
        if self._on_terminal:
            print(flush=True)


def _sample_times(duration_s: float, rate_hz: float) -> Iterator[float]:
    """Yield the times from 0 to ``duration_s``, both included."""
    count = int(np.floor(duration_s * rate_hz + 1e-9))
    for index in range(count + 1):
        yield index / rate_hz
    if count / rate_hz < duration_s:
        yield duration_s

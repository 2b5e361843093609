"""The demonstration: node and simulated arm as processes, a streamed trajectory, the recording, the report."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import numpy as np
import rclpy
import yaml
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.report import GroundTruth, ground_truth_from_trajectory
from ik_node.robot.simulator_parameters import SIMULATOR
from ik_node.ros.child_process import NodeProcess
from ik_node.ros.demo.new_folder import new_folder
from ik_node.ros.demo.options import CheckedRun, DemoOptions
from ik_node.ros.demo.plan import HOLD_S, PlannedMotion, compile_functions, write_report
from ik_node.ros.demo.target_streamer import TargetStreamer

READY_TIMEOUT_S = 120.0
"""Includes the compilation by the node where machine code cannot be stored on disk."""
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
                compile_functions(self._robot)
                rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
                try:
                    with self._simulator(out) as simulator, self._node(out) as node:
                        truth = self._watched([simulator, node])
                finally:
                    rclpy.try_shutdown()
                write_report(out, truth, self._options)
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
        motion = PlannedMotion(self._run, self._options, start_pose)

        def may_continue() -> bool:
            if not self._interrupted:
                check_processes()
            return not self._interrupted

        progress = Progress(streamer, motion.whole, may_continue)
        start_ros_ns = streamer.stream(motion.targets(), progress)
        if not self._interrupted:
            streamer.spin_for(HOLD_S)
        progress.close()
        executor.shutdown(0.5)
        streamer.destroy_node()
        return ground_truth_from_trajectory(motion.trajectory, start_ros_ns + round(motion.approach.duration_s * NS))


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

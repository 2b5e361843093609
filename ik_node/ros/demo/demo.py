"""The demonstration: node and simulated robot as processes, a streamed trajectory, the recording, the report."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from types import FrameType

import numpy as np
import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ik_node import resources
from ik_node.control.warm_up import rehearse
from ik_node.errors import IkNodeError, SettingsError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Trajectory
from ik_node.jit import is_cold
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.report import FILE_NAME, Truth, as_json, as_text, figures, truth_from, write_truth
from ik_node.report.summary_page import draw
from ik_node.robot.catalogue import robot_from
from ik_node.ros.child_process import NodeProcess
from ik_node.ros.demo.target_streamer import DemoNode
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_settings
from ik_node.trajectory import pose_file, shapes
from ik_node.trajectory.pose_file import PoseFileFormat, PoseFileTrajectory

READY_TIMEOUT_S = 120.0
"""Where compiled functions cannot be kept on disk, the node compiles them anew."""
STREAM_RATE_HZ = 50.0
REST_S = 0.6
"""After the last target: long enough to see that the end of the stream is noticed."""
PROGRESS_S = 0.2


@dataclass(frozen=True)
class DemoOptions:
    """What to demonstrate."""

    robot: str
    config: Path | None
    trajectory: str
    """A name in SHAPES, or a file."""
    file_format: PoseFileFormat
    target_rate_hz: float | None
    rate_hz: float | None
    overrides: tuple[str, ...]
    """``name:=value`` for the node."""
    out: Path
    show: bool
    """Open the picture at the end where there is a screen."""


class Demonstration:
    """One run from start to report."""

    def __init__(self, options: DemoOptions) -> None:
        """Raises our errors when the configuration, the robot or the output folder is not usable."""
        self._options = options
        self._config = options.config or _config_for(options.robot)
        settings = Settings() if self._config is None else read_settings(self._config)
        self._robot = robot_from(dataclasses.replace(settings.arm, robot=options.robot))
        self._interrupted = False
        if options.out.exists():
            raise SettingsError(f"folder '{options.out}' exists already; it is not overwritten")

    def run(self) -> int:
        """Runs it; 0 at its end, 130 when it was interrupted; the recording is whole and reported in both cases."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
        out = self._options.out
        out.mkdir(parents=True)
        if is_cold():
            print("compiling, once for this version: half a minute", flush=True)
            rehearse(self._robot, Settings())
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        try:
            with self._simulator(out) as simulator, self._node(out) as node:
                truth = self._lead([simulator, node])
        finally:
            rclpy.try_shutdown()
        self._report(out, truth)
        return 130 if self._interrupted else 0

    # --- processes ---------------------------------------------------------------------------------------------------

    def _simulator(self, out: Path) -> NodeProcess:
        arguments = [*self._common("ik_simulator"), "-r", "commands:=/ik_node/commands"]
        return NodeProcess("ik_node.cli.simulator", arguments, {}, out / "ik_simulator.log")

    def _node(self, out: Path) -> NodeProcess:
        recording = ["recording.enabled:=true", f"recording.directory:={out / 'bag'}"]
        arguments = self._common("ik_node")
        for value in (*recording, *self._options.overrides):
            arguments += ["-p", f"ik_node:{value}"]
        return NodeProcess("ik_node.cli.node", arguments, {}, out / "ik_node.log")

    def _common(self, node: str) -> list[str]:
        """The file comes first, and values bear the node's name as the file does: else the file's go before."""
        arguments = [] if self._config is None else ["--params-file", str(self._config)]
        arguments += ["-p", f"{node}:robot:={self._options.robot}"]
        if self._options.rate_hz is not None:
            arguments += ["-p", f"{node}:rate_hz:={float(self._options.rate_hz)!r}"]
        return arguments

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self._interrupted = True

    # --- leading -----------------------------------------------------------------------------------------------------

    def _lead(self, processes: list[NodeProcess]) -> Truth:
        executor = EventsExecutor()
        leader = DemoNode(self._robot, executor)

        def alive() -> None:
            for process in processes:
                if process.exit_code is not None:
                    raise IkNodeError(f"{process.module} ended with code {process.exit_code}:\n{process.last_words()}")
            if self._interrupted:
                raise IkNodeError("interrupted before the run began")

        print(f"starting {self._options.robot}: ik_node and ik_simulator over DDS", flush=True)
        leader.wait_until_ready(READY_TIMEOUT_S, alive)
        start_pose = leader.measured_pose()
        trajectory = self._trajectory(start_pose)
        begin = trajectory.pose(0.0)
        approach = shapes.straight_line(start_pose, begin)
        whole = shapes.sequence(approach, trajectory)
        if approach.duration_s:
            print(f"approach of {approach.duration_s:.1f} s to the first pose, then the trajectory", flush=True)

        def goes_on() -> bool:
            if not self._interrupted:
                alive()
            return not self._interrupted

        progress = Progress(leader, whole, goes_on)
        start_ros_ns = leader.stream(self._targets(approach, trajectory), progress)
        if not self._interrupted:
            leader.rest(REST_S)
        progress.done()
        executor.shutdown(0.5)
        leader.destroy_node()
        return truth_from(trajectory, start_ros_ns + round(approach.duration_s * NS))

    def _trajectory(self, start_pose: Array) -> Trajectory:
        name = self._options.trajectory
        if name in shapes.SHAPES:
            return shapes.SHAPES[name](start_pose)
        path = Path(name)
        if not path.is_file():
            raise SettingsError(f"no trajectory '{name}'; valid: {', '.join(shapes.SHAPES)}, or a file of poses")
        loaded = pose_file.load(path, self._options.file_format, start_pose)
        print(loaded.describe(), flush=True)
        return loaded

    def _targets(self, approach: Trajectory, trajectory: Trajectory) -> Iterator[tuple[float, Array]]:
        """Times and poses to send: a file at its own times unless a rate is asked for, all else at a steady rate."""
        rate_hz = self._options.target_rate_hz
        begin_s = approach.duration_s
        for time_s in _steady(begin_s, rate_hz or STREAM_RATE_HZ):
            if time_s < begin_s:
                yield time_s, approach.pose(time_s)
        if rate_hz is None and isinstance(trajectory, PoseFileTrajectory):
            for sample in trajectory.samples():
                yield begin_s + sample.time_s, sample.pose
            return
        for time_s in _steady(trajectory.duration_s, rate_hz or STREAM_RATE_HZ):
            yield begin_s + time_s, trajectory.pose(time_s)

    # --- afterwards --------------------------------------------------------------------------------------------------

    def _report(self, out: Path, truth: Truth) -> None:
        write_truth(out / FILE_NAME, truth)
        run = load_run(out / "bag")
        report = figures(run, truth, self._trajectory_name())
        picture = out / "report.png"
        draw(run, report, picture)
        (out / "report.json").write_text(as_json(report))
        print(as_text(report))
        print(f"recording {out / 'bag'}\npicture   {picture}", flush=True)
        if self._options.show and sys.stdout.isatty() and which("xdg-open"):
            subprocess.Popen(["xdg-open", str(picture)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def _trajectory_name(self) -> str:
        name = self._options.trajectory
        return name if name in shapes.SHAPES else Path(name).name


class Progress:
    """A line about the run while it runs: rewritten on a terminal, now and then elsewhere."""

    def __init__(self, leader: DemoNode, whole: Trajectory, goes_on: Callable[[], bool]) -> None:
        self._leader = leader
        self._whole = whole
        self._goes_on = goes_on
        self._on_terminal = sys.stdout.isatty()
        self._every_s = 0.1 if self._on_terminal else 2.0
        self._next_s = 0.0

    def __call__(self, time_s: float) -> bool:
        """Says where the run is; False when it has to end."""
        if time_s >= self._next_s:
            self._next_s = time_s + self._every_s
            distance = self._leader.measured_pose()[:3, 3] - self._whole.pose(time_s)[:3, 3]
            mode, reason = self._leader.status
            line = f"{time_s:6.1f} / {self._whole.duration_s:.1f} s  off by {1e3 * np.linalg.norm(distance):6.2f} mm"
            line += f"  {mode}: {reason}"
            print(
                f"\r{line:<100.100}" if self._on_terminal else line, end="" if self._on_terminal else "\n", flush=True
            )
        return self._goes_on()

    def done(self) -> None:
        """Ends the line."""
        if self._on_terminal:
            print(flush=True)


def _steady(duration_s: float, rate_hz: float) -> Iterator[float]:
    """Times from 0 to ``duration_s``, the end included."""
    count = int(np.floor(duration_s * rate_hz + 1e-9))
    for index in range(count + 1):
        yield index / rate_hz
    if count / rate_hz < duration_s:
        yield duration_s


def _config_for(robot: str) -> Path | None:
    """The shipped configuration of a robot; None where there is none, so that defaults hold."""
    try:
        return resources.config_file(f"{robot}.yaml")
    except SettingsError:
        return None

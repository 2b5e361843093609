"""What a demonstration does, whether over DDS or in one process: the motion, its targets, and the report."""

from __future__ import annotations

import functools
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from shutil import which

import numpy as np

from ik_node.control.compilation import compile_and_warm_up
from ik_node.interfaces.motion import Trajectory
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.jit import is_cold
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.report import GROUND_TRUTH_FILE, GroundTruth, as_json, as_text, compute_metrics, write_ground_truth
from ik_node.report.recorded_scene import read_obstacles
from ik_node.report.summary_page import save_summary
from ik_node.robot.robot import Robot
from ik_node.ros.demo.options import CheckedRun, DemoOptions
from ik_node.settings.groups import Settings
from ik_node.trajectory import shapes
from ik_node.trajectory.pose_file import PoseFileTrajectory

STREAM_RATE_HZ = 50.0
SIZES = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15)
"""Sizes of a built-in trajectory, relative to that for arms of 0.6 m reach and more."""
CHECKED_POSES, MAX_ITERATIONS = 60, 60
HOLD_S = 0.6
"""Time after the last target; the node detects the end of the stream in it."""


class PlannedMotion:
    """The approach to the first pose of a trajectory, and the trajectory."""

    def __init__(self, run: CheckedRun, options: DemoOptions, start_pose: Array) -> None:
        """Read the trajectory; ``start_pose`` is T_sb, (4, 4)."""
        self.trajectory: Trajectory
        if run.poses is None:
            self.trajectory = reachable(run, shapes.SHAPES[options.trajectory](start_pose))
        else:
            loaded = run.poses.trajectory(start_pose)
            print(loaded.describe(), flush=True)
            self.trajectory = loaded
        self.approach = shapes.straight_line(start_pose, self.trajectory.pose(0.0))
        self.whole = shapes.sequence(self.approach, self.trajectory)
        self._rate_hz = options.target_rate_hz
        if self.approach.duration_s:
            print(f"{self.approach.duration_s:.1f} s approach to the first pose, then the trajectory", flush=True)

    def targets(self) -> Iterator[tuple[float, Array]]:
        """Yield (time_s, T_sd): a file at its own times unless a rate is given, otherwise at a constant rate."""
        begin_s = self.approach.duration_s
        for time_s in _sample_times(begin_s, self._rate_hz or STREAM_RATE_HZ):
            if time_s < begin_s:
                yield time_s, self.approach.pose(time_s)
        if self._rate_hz is None and isinstance(self.trajectory, PoseFileTrajectory):
            for sample in self.trajectory.samples():
                yield begin_s + sample.time_s, sample.pose
            return
        for time_s in _sample_times(self.trajectory.duration_s, self._rate_hz or STREAM_RATE_HZ):
            yield begin_s + time_s, self.trajectory.pose(time_s)


def reachable(run: CheckedRun, trajectory: Trajectory) -> Trajectory:
    """The trajectory in the largest of :data:`SIZES` that the arm can follow from its start posture.

    Inverse kinematics within the joint limits, each pose from the solution of the one before. A trajectory that the
    arm can follow in none of the sizes stays as it is.
    """
    task = run.settings.task
    solver = PoseSolver(
        run.robot.copy(),
        search_iterations=MAX_ITERATIONS,
        max_iterations=MAX_ITERATIONS,
        tolerance=TaskTolerance(task.tolerance, task.frame),
        compared_searches=1,
        locked=run.settings.control.locked_joints,
    )
    simulated = dict(zip(run.simulated_robot.joints, run.simulator["initial_position"], strict=True))
    start = np.array([simulated[name] for name in run.robot.joints])
    for size in SIZES:
        scaled, q = trajectory if size == 1.0 else shapes.ScaledTrajectory(trajectory, size), start
        for time_s in np.linspace(0.0, trajectory.duration_s, CHECKED_POSES).tolist():
            solution = solver.solve(scaled.pose(time_s), q, restarts=0)
            if not solution.converged:
                break
            q = solution.q
        else:
            if size < 1.0:
                print(
                    f"the trajectory has {100.0 * size:g} % of its size, with which the arm can follow it", flush=True
                )
            return scaled
    return trajectory


def compile_functions(robot: Robot) -> None:
    """Compile the functions of the control step, with progress, unless that was done before."""
    if is_cold():
        compile_and_warm_up(robot, Settings(), functools.partial(print, flush=True))


def write_report(out: Path, truth: GroundTruth, options: DemoOptions) -> None:
    """Write truth, metrics and picture beside the recording, and print the metrics."""
    write_ground_truth(out / GROUND_TRUTH_FILE, truth)
    run = load_run(out / "bag")
    name = options.trajectory if options.trajectory in shapes.SHAPES else Path(options.trajectory).name
    obstacles = read_obstacles(out / "bag")
    report = compute_metrics(run, truth, name, obstacles=obstacles)
    picture = out / "report.png"
    save_summary(run, report, picture, obstacles.at_start)
    (out / "report.json").write_text(as_json(report))
    print(as_text(report))
    print(f"recording {out / 'bag'}\npicture   {picture}\nlook at it: ik_view {out / 'bag'}", flush=True)
    show_picture(picture, options)


def show_picture(picture: Path, options: DemoOptions) -> None:
    """Open a picture, if that is wanted and there is a screen."""
    if options.show and sys.stdout.isatty() and which("xdg-open"):
        subprocess.Popen(["xdg-open", str(picture)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _sample_times(duration_s: float, rate_hz: float) -> Iterator[float]:
    """Yield the times from 0 to ``duration_s``, both included."""
    count = int(np.floor(duration_s * rate_hz + 1e-9))
    for index in range(count + 1):
        yield index / rate_hz
    if count / rate_hz < duration_s:
        yield duration_s

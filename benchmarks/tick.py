"""``ik_benchmark tick``: the whole control step, joint state in, Step out, beside pink and mink in the same run.

Candidates take turns, a block of steps each, so that all of them see the same machine. The 10th percentile is compared:
it repeats within a few percent where medians do not. Every step is checked: J qd = s V_f + off-direction twist for the
controller, and the task's velocity for pink and mink where no limit acts.
"""

from __future__ import annotations

import argparse
import gc
import json
import platform
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from benchmarks.tick_parts import PartTimes
from benchmarks.tick_rivals import make_mink, make_pink
from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import Obstacle, Scene, obstacle, shape
from ik_node.control.controller import Controller
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import JointSample, PoseSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.report.canvas import convert_write_errors, new_figure, report_style
from ik_node.report.style import BLUE, VERMILION
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ArmSettings, Settings

RATE_HZ = 500.0
BLOCK = 50
"""Steps of one candidate between those of the others."""
RADIUS_M, PERIOD_S = 0.05, 4.0
"""The tool moves on a circle."""
TARGET_STEPS = 10
"""Steps per streamed pose: 50 Hz."""
OBSTACLE_M = 0.08
ROOM_M = 0.12
"""Least distance of obstacles from the arm at the start."""
SEED = 1
ARMS = {
    "panda": ArmSettings(robot="panda"),
    "ur5": ArmSettings(robot="ur5"),
    "g1": ArmSettings(robot="g1_29dof_rev_1_0", base_frame="torso_link", tip_frame="left_rubber_hand"),
}
START = {
    "panda": (0.0, -0.5, 0.0, -2.2, 0.0, 1.8, 0.785),
    "ur5": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0),
    "g1": (0.2, 0.3, 0.0, 0.8, 0.0, 0.2, 0.1),
}
SINGULAR = {
    "panda": (0.0, 0.4, 0.0, -0.1, 0.0, 1.2, 0.785),
    "ur5": (0.0, -1.0, 0.05, -1.2, -1.57, 0.0),
    "g1": (0.2, 0.3, 0.0, 1.5, 0.0, 0.2, 0.1),
}
"""Nearly stretched elbows."""
RIVALS = ("pink", "mink")
TICKS_US = (20, 50, 100, 200, 500, 1000, 2000, 5000)
ROW_IN = 0.24
"""Height of a row of the chart."""
CASES = ("free", "bound", "singular", "pointing", "band")
"""bound: a quarter of the velocity that the circle needs is permitted; pointing: the rotation about the tool's z is
free; band: besides, 0.2 rad about x and y are."""
TOLERANCES = {"pointing": (0.0, 0.0, 0.0, 0.0, 0.0, np.inf), "band": (0.0, 0.0, 0.0, 0.2, 0.2, np.inf)}


class Candidate(Protocol):
    """A program that computes joint velocities."""

    name: str

    def target(self, pose: Array, time_ns: int) -> None:
        """Sets the desired pose; not measured."""

    def step(self, q: Array, time_ns: int) -> Array:
        """Joint velocities at q (n,); measured."""

    def residual(self) -> float:
        """Largest deviation of the last step from its task, m/s or rad/s; NaN where a limit acts."""


class Ours:
    """The controller of the node."""

    def __init__(self, name: str, robot: Robot, settings: Settings, scene: Scene) -> None:
        self.name = name
        self._robot = robot
        self._exact = 6 if settings.task.tolerance.count(0.0) == 6 else 3  # the position is exact in all cases
        self._controller = Controller(robot, settings)
        self._controller.collision_monitor.scene = scene
        self._still = np.zeros(robot.n)
        self._step: Any = None

    def target(self, pose: Array, time_ns: int) -> None:
        """As in :class:`Candidate`."""
        quaternion = se3.quaternion_from_rotation(pose[:3, :3])
        sample = PoseSample(0, self._robot.base_frame, pose[:3, 3], quaternion)
        self._controller.on_target_pose(sample, Instant(time_ns, time_ns))

    def step(self, q: Array, time_ns: int) -> Array:
        """As in :class:`Candidate`."""
        self._step = self._controller.on_joint_state(JointSample(0, self._robot.joints, q), Instant(time_ns, time_ns))
        return self._still if self._step is None else self._step.joint_velocity

    def residual(self) -> float:
        """As in :class:`Candidate`."""
        step = self._step
        if step is None or not np.isfinite(step.scale):
            return float("nan")
        followed = step.scale * (step.twist_b - step.truncated_b) + step.off_direction_b
        # The Jacobian of the middle of the interval: q + h/2 qd of the last command.
        jacobian = self._robot.evaluate(step.joint_position).jacobian_b
        return float(np.abs(jacobian @ step.joint_velocity - followed)[: self._exact].max())


class Row(NamedTuple):
    """Figures of one candidate in one case."""

    robot: str
    case: str
    obstacles: int
    candidate: str
    p10_us: float
    median_us: float
    p99_us: float
    worst_residual: float
    """Median deviation of J qd from the task of the step, m/s or rad/s."""


def scene_of(robot: Robot, q: Array, count: int, far: int) -> Scene:
    """``count`` spheres around the arm, none of which it touches at q (n,), and ``far`` more out of its reach."""
    rng, scene = np.random.default_rng(SEED), dict[str, Obstacle]()
    query = DistanceQuery(collision_geometry.load(robot, self_collision=False))
    for index in range(count + far):
        pose = np.eye(4)
        if index < count:
            while True:
                pose[:3, 3] = rng.uniform(-0.8, 0.8, 3)
                query.set_scene(Scene({"0": obstacle("0", shape("sphere", (OBSTACLE_M,)), pose.copy())}), 0)
                if query.measure(q, 0.0)[1].distance > ROOM_M:
                    break
        else:
            direction = rng.normal(size=3)
            pose[:3, 3] = rng.uniform(2.5, 5.0) * direction / np.linalg.norm(direction)
        scene[str(index)] = obstacle(str(index), shape("sphere", (OBSTACLE_M,)), pose)
    return Scene(scene)


def circle(start: Array, time_s: float) -> Array:
    """Pose of the tool at a time, with ``start`` at 0."""
    angle = 2.0 * np.pi * time_s / PERIOD_S
    pose = start.copy()
    pose[:3, 3] += RADIUS_M * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)])
    return np.asarray(pose)


def compare(
    candidates: Sequence[Candidate], robot: Robot, start: Array, steps: int, after: Callable[[], None] = lambda: None
) -> list[tuple[Array, Array]]:
    """Runs all candidates in turns; returns times, us, and residuals of each step of each candidate.

    ``after`` is called after each step, before its residual is computed.
    """
    period_ns = round(NS / RATE_HZ)
    lower, upper = robot.limits.lower, robot.limits.upper
    pose = robot.pose(start)
    states = [start.copy() for _ in candidates]
    results = [(np.full(steps, np.nan), np.full(steps, np.nan)) for _ in candidates]
    gc.collect()
    gc.disable()
    try:
        for begin in range(0, steps, BLOCK):
            for number, candidate in enumerate(candidates):
                q, (times, residuals) = states[number], results[number]
                for tick in range(begin, min(begin + BLOCK, steps)):
                    time_ns = NS + tick * period_ns
                    if tick % TARGET_STEPS == 0:
                        candidate.target(circle(pose, tick / RATE_HZ), time_ns)
                    begin_ns = time.perf_counter_ns()
                    qd = candidate.step(q, time_ns)
                    times[tick] = 1e-3 * (time.perf_counter_ns() - begin_ns)
                    after()
                    residuals[tick] = candidate.residual()
                    q = np.clip(q + qd / RATE_HZ, lower, upper)
                states[number] = q
    finally:
        gc.enable()
    return results


def parts(arm: str, obstacles: int, steps: int) -> None:
    """Prints where the time of a control step goes, per method, without distances and as shipped."""
    for method in ("plain", "inertia_weighted", "obstacle_gradient"):
        for geometry in ("none", "hull"):
            if method == "obstacle_gradient" and geometry == "none":
                continue
            values: dict[str, Any] = {"rate_hz": RATE_HZ, "follow.enabled": False, "method": method}
            settings = Settings(arm=ARMS[arm]).with_values({**values, "obstacles.geometry": geometry})
            robot = catalogue.robot_from_settings(settings.arm)
            start = np.array(START[arm])[: robot.n]
            scene = scene_of(robot, start, obstacles if method == "obstacle_gradient" else 0, 0)
            candidate = Ours(method, robot, settings, scene)
            compare([candidate], robot, start, steps // 2)  # what the first steps alone compute
            times = PartTimes()
            try:
                candidate = Ours(method, robot, settings, scene)
                compare([candidate], robot, start, steps, times.next_step)
            finally:
                times.close()
            what = f"{len(scene.obstacles)} obstacles" if len(scene.obstacles) else f"obstacles.geometry {geometry}"
            print(f"{arm}, {method}, {what}\n{times.table()}", flush=True)


def measure(arm: str, case: str, obstacles: int, steps: int, rivals: bool) -> list[Row]:
    """One comparison."""
    values: dict[str, Any] = {"rate_hz": RATE_HZ, "follow.enabled": False}
    if case == "bound":
        values["limits.velocity_fraction"] = 0.02
    if case in TOLERANCES:
        values["task.tolerance"] = TOLERANCES[case]
    near = min(obstacles, 20)
    settings = Settings(arm=ARMS[arm]).with_values(values)
    robot = catalogue.robot_from_settings(settings.arm)
    start = np.array((SINGULAR if case == "singular" else START)[arm])[: robot.n]
    scene = scene_of(robot, start, near, obstacles - near)
    candidates: list[Candidate] = []
    for method in ("plain", "inertia_weighted", "obstacle_gradient"):
        if method == "obstacle_gradient" and not obstacles:
            continue
        chosen = settings.with_values({"method": method})
        candidates.append(Ours(method, robot, chosen, scene))
        if not obstacles:
            without = chosen.with_values({"obstacles.geometry": "none"})
            candidates.append(Ours(f"{method}, no distances", robot, without, scene))
    if rivals and obstacles <= 20 and case == "free" and arm != "g1":
        candidates += [made for make in (make_pink, make_mink) if (made := make(robot, scene, RATE_HZ)) is not None]
    rows = []
    for candidate, (times, residuals) in zip(candidates, compare(candidates, robot, start, steps), strict=True):
        p10, median, p99 = np.quantile(times[steps // 5 :], (0.1, 0.5, 0.99)).tolist()
        worst = float(np.nanmedian(residuals)) if np.isfinite(residuals).any() else float("nan")
        rows.append(Row(arm, case, obstacles, candidate.name, p10, median, p99, worst))
    return rows


def chart(rows: Sequence[Row], file: Path) -> None:
    """Draws the 10th percentile to the median, and the 99th percentile, of each candidate on a logarithmic scale."""
    with report_style(), convert_write_errors():
        figure = new_figure(1.2 + ROW_IN * len(rows))
        axes = figure.subplots()
        for place, row in enumerate(rows):
            colour = VERMILION if row.candidate in RIVALS else BLUE
            axes.plot((row.p10_us, row.median_us), (place, place), color=colour, linewidth=5.0, solid_capstyle="butt")
            axes.plot(row.p99_us, place, "|", color=colour, markersize=9.0)
        labels = [f"{row.robot}, {row.case}, {row.obstacles} obstacles: {row.candidate}" for row in rows]
        axes.set_yticks(range(len(rows)), labels, fontsize="small")
        axes.set_xscale("log")
        axes.set_xticks(TICKS_US, [str(value) for value in TICKS_US])
        axes.set_xlim(0.9 * min(row.p10_us for row in rows), 1.1 * max(row.p99_us for row in rows))
        axes.tick_params(axis="x", which="minor", labelbottom=False)
        axes.set_xlabel("control step, \N{MICRO SIGN}s: 10th percentile to median, and 99th percentile")
        axes.set_ylim(len(rows) - 0.3, -0.7)
        figure.savefig(file, bbox_inches="tight")


def ratios(rows: Sequence[Row]) -> dict[str, float]:
    """Ratios of 10th percentiles, by name."""
    found = {(row.robot, row.case, row.obstacles, row.candidate): row.p10_us for row in rows}

    def ratio(first: tuple[str, str, int, str], second: tuple[str, str, int, str]) -> float:
        return found[first] / found[second] if first in found and second in found else float("nan")

    panda = "panda", "free"
    pairs = {
        "plain without distances / pink": ((*panda, 0, "plain, no distances"), (*panda, 0, "pink")),
        "plain as shipped / pink": ((*panda, 0, "plain"), (*panda, 0, "pink")),
        "obstacle_gradient with 20 / mink": ((*panda, 20, "obstacle_gradient"), (*panda, 20, "mink")),
        "obstacle_gradient with 20 / pink": ((*panda, 20, "obstacle_gradient"), (*panda, 20, "pink")),
        "obstacle_gradient with 200 / 20": ((*panda, 200, "obstacle_gradient"), (*panda, 20, "obstacle_gradient")),
        "obstacle_gradient with 2000 / 20": ((*panda, 2000, "obstacle_gradient"), (*panda, 20, "obstacle_gradient")),
    }
    return {name: ratio(*pair) for name, pair in pairs.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 when a step does not agree with its task."""
    parser = argparse.ArgumentParser(prog="ik_benchmark tick", description=__doc__)
    parser.add_argument("--robots", nargs="+", choices=list(ARMS), default=list(ARMS), help="[%(default)s]")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), help="[%(default)s]")
    parser.add_argument(
        "--obstacles", nargs="+", type=int, default=[0, 5, 20, 200, 2000], help="20 at most are near [%(default)s]"
    )
    parser.add_argument("--steps", type=int, default=2000, help="steps per candidate [%(default)s]")
    parser.add_argument("--parts", action="store_true", help="print where the time of a step goes, and nothing else")
    parser.add_argument("--ours", action="store_true", help="without pink and mink")
    parser.add_argument("--json", type=Path, help="also write the figures to a file")
    parser.add_argument("--chart", type=Path, metavar="PNG", help="also draw them")
    options = parser.parse_args(arguments)
    if options.parts:
        for arm in options.robots:
            parts(arm, 20, options.steps)
        return 0
    rows: list[Row] = []
    print(f"{'robot':7}{'case':10}{'obstacles':>10}  {'candidate':34}{'10 %':>8}{'median':>8}{'99 %':>8} us   residual")
    for arm in options.robots:
        for case in options.cases:
            for obstacles in options.obstacles if case == "free" else options.obstacles[:1]:
                for row in measure(arm, case, obstacles, options.steps, not options.ours):
                    rows.append(row)
                    times = f"{row.p10_us:8.1f}{row.median_us:8.1f}{row.p99_us:8.1f}"
                    print(
                        f"{row.robot:7}{row.case:10}{row.obstacles:10d}  {row.candidate:34}{times}"
                        f"    {row.worst_residual:.1e}",
                        flush=True,
                    )
    found = {name: value for name, value in ratios(rows).items() if np.isfinite(value)}
    for name, value in found.items():
        print(f"{name}: {value:.3f} (1/{1.0 / value:.1f})")
    if options.json:
        machine = {"processor": platform.processor() or platform.machine(), "python": platform.python_version()}
        content = {"machine": machine, "rows": [row._asdict() for row in rows], "ratios": found}
        options.json.write_text(json.dumps(content, indent=1))
    if options.chart:
        chart(rows, options.chart)
    return 0 if all(not row.worst_residual > MAX_RESIDUAL for row in rows) else 1


MAX_RESIDUAL = 1e-2
"""m/s, rad/s: J is that of the measured position here and that of the middle of the interval in the step."""


if __name__ == "__main__":
    sys.exit(main())

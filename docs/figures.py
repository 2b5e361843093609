"""Pictures of the methods and of tolerances: runs of ``ik_demo --no-ros`` on the same motion, drawn with matplotlib."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node import resources
from ik_node.cli import demo
from ik_node.math.se3 import rotation_from_quaternion
from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import COMPONENTS, TaskTolerance
from ik_node.math.types import Array
from ik_node.report.canvas import report_style
from ik_node.report.reported_run import ReportedRun, read_reported_runs
from ik_node.report.style import BLUE, GREEN, GREY, LIGHT_GREY, PURPLE, TEXT_COLOUR, VERMILION
from ik_node.robot.robot import Robot

SIZE_IN, DPI, QUALITY = (8.0, 3.1), 100, 80
FRAMES = 9
"""Number of tool frames that are drawn along a path."""
AXIS_COLOURS = (VERMILION, GREEN, BLUE)
SETTLE_S = 1.0
"""The approach to the trajectory is not drawn."""


class Curve(NamedTuple):
    """What a method lowers."""

    title: str
    values: Callable[[ReportedRun], tuple[Array, Array]]
    """Times, s, and values."""
    beside: str
    """Method that it is compared with."""


def _joint_speed(reported: ReportedRun) -> tuple[Array, Array]:
    return reported.times_s, np.linalg.norm(reported.run.joint_velocity, axis=1)


def _third_joint(reported: ReportedRun) -> tuple[Array, Array]:
    return reported.times_s, np.abs(reported.run.joint_velocity[:, 2])


def _kinetic(reported: ReportedRun) -> tuple[Array, Array]:
    return reported.times_s, reported.metrics.energy_series.kinetic


def _gravitational(reported: ReportedRun) -> tuple[Array, Array]:
    values = reported.metrics.energy_series.gravitational
    return reported.times_s, values - values[np.isfinite(values)][0]


def _clearance(reported: ReportedRun) -> tuple[Array, Array]:
    series = reported.metrics.clearance_series
    assert series is not None
    return series.times_s - reported.zero_s, 1e3 * series.obstacle


METHODS = {
    "plain": Curve("Norm of the joint velocity [rad/s]", _joint_speed, "inertia_weighted"),
    "joint_weighted": Curve("Speed of joint 3 [rad/s]", _third_joint, "plain"),
    "inertia_weighted": Curve("Kinetic energy of the command [J]", _kinetic, "plain"),
    "gravity_gradient": Curve("Gravitational energy - that at the start [J]", _gravitational, "plain"),
    "obstacle_gradient": Curve("Clearance to the ball [mm]", _clearance, "plain"),
}
WEIGHTS = ("--set", "joint_weights=[1.0, 1.0, 10.0, 1.0, 1.0, 1.0, 1.0]")
"""Those of ``joint_weighted`` in its picture."""
TASKS: dict[str, tuple[Sequence[str], str, Sequence[str]]] = {
    "welding": (
        ("--robot", "ur5", "--trajectory", "line"),
        "0 0 0 0 0 inf",
        ("rz",),
    ),
    "camera": (("--robot", "ur5"), "0 0 0.05 0 0 inf", ("z", "rz")),
    "pouring": (("--robot", "ur5"), "0 0 0 0.1 0.1 inf", ("rx", "ry", "rz")),
    "so101": (("--robot", "so101", "--trajectory", "line"), "0 0 0 0 0 inf", ("rz",)),
}
"""Name -> options of ``ik_demo``, half-widths, components that are not exact."""
BASE = ("pouring", "so101")
"""Tasks with the axes of the base."""
TORCH = (
    *("--robot", "ur5", "--trajectory", "hold", "--method", "obstacle_gradient"),
    *("--set", "tool_offset=[0.1, 0.0, 0.1, 0.0, 0.38268343, 0.0, 0.92387953]"),
    *("--set", "obstacles.self_collision=false"),
)
"""A UR5 that holds a torch at 45 deg beside the ball :data:`TORCH_BALL`."""
TORCH_BALL, BALL_RADIUS_M = (0.3, 0.1, 0.3), 0.05


def draw_methods(to: Path) -> None:
    """Draws one picture per method: the arm beside that of another method, and what the method lowers."""
    scene = str(resources.config_file("scenes/ball.yaml"))
    with tempfile.TemporaryDirectory() as folder:
        bags = {name: _recorded(Path(folder) / name, "--method", name, "--scene", scene, *WEIGHTS) for name in METHODS}
        runs = dict(zip(bags, read_reported_runs(list(bags.values())), strict=True))
        for name, curve in METHODS.items():
            _draw_method(to / f"{name}.webp", name, curve, runs)


def draw_tasks(to: Path) -> None:
    """Draws one picture per task: the tool along its path with and without the tolerance, and the deviation."""
    with tempfile.TemporaryDirectory() as folder:
        for name, (options, widths, shown) in TASKS.items():
            frame = "base" if name in BASE else "tool"
            numbers = ", ".join(f".{word}" if word == "inf" else f"{float(word)}" for word in widths.split())
            tolerance = ("--set", f"task.tolerance=[{numbers}]", "--set", f"task.frame={frame}")
            exact = ("--set", f"task.tolerance=[{', '.join(['0.0'] * 6)}]")
            bags = [
                _recorded(Path(folder) / f"{name}_{kind}", *options, *extra)
                for kind, extra in (("exact", exact), ("tolerance", tolerance))
            ]
            task = TaskTolerance([float(word) for word in widths.split()], frame)
            _draw_task(to / f"{name}.webp", read_reported_runs(bags), task, shown)
    draw_pushed_away(to / "pushed_away.webp")


def draw_pushed_away(path: Path) -> None:
    """Draws a UR5 that points, and the same with its whole pose held, while a ball pushes the arm away."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.yaml"
        shape = f"sphere: {{radius: {BALL_RADIUS_M}}}"
        scene.write_text(f"obstacles: [{{name: ball, {shape}, position: {list(TORCH_BALL)}}}]")
        tolerance = "task.tolerance=[0.0, 0.0, 0.0, 0.0, 0.0, {}]"
        bags = [
            _recorded(Path(folder) / f"spin_{spin}", *TORCH, "--scene", str(scene), "--set", tolerance.format(spin))
            for spin in ("0.0", ".inf")
        ]
        held, pointing = read_reported_runs(bags)
    pair = ((held, GREY, "whole pose"), (pointing, BLUE, "spin free"))
    with report_style():
        figure, space, upper, lower = _figure()
        points = []
        for reported, colour, label in pair:
            row = int(np.flatnonzero(np.isfinite(reported.run.q).all(axis=1))[-1])
            points.append(_arm_points(reported, row))
            space.plot(*points[-1].T, color=colour, linewidth=3.0, marker="o", markersize=3.5, label=label)
            times, values = _clearance(reported)
            upper.plot(times, values, color=colour)
            upper.annotate(f"{values[-1]:.0f} mm", (times[-1], values[-1]), xytext=(-2, 3), ha="right", fontsize=8,
                           textcoords="offset points", color=colour)  # fmt: skip
        ball = np.array(TORCH_BALL)
        _draw_ball(space, ball, BALL_RADIUS_M)
        _equal(space, np.concatenate([*points, ball[None] - BALL_RADIUS_M, ball[None] + BALL_RADIUS_M]))
        _caption(figure, "At the end; the torch points as before")
        figure.legend(*space.get_legend_handles_labels(), loc="lower left", bbox_to_anchor=(0.01, 0.06), ncols=2,
                      frameon=False, fontsize=8)  # fmt: skip
        upper.set_title("Clearance to the ball [mm]")
        upper.margins(y=0.3)
        for index, colour in ((3, VERMILION), (4, GREEN), (5, BLUE)):
            times, deviation = _deviation(pointing, TaskTolerance((0, 0, 0, 0, 0, np.inf)))
            lower.plot(times, np.degrees(deviation[:, index]), color=colour, label=COMPONENTS[index])
        lower.set_title("Rotation of the torch [deg]")
        lower.legend(loc="lower right", bbox_to_anchor=(1.02, 0.96), ncols=3, frameon=False, fontsize=8,
                     handlelength=0.9, columnspacing=0.8)  # fmt: skip
        _share_time(upper, lower, pointing)
        for axes in (upper, lower):
            axes.set_xlim(left=float(_clearance(pointing)[0][0]))  # the arm moves before the first target
        _save(figure, path)


def _recorded(folder: Path, *options: str) -> Path:
    """Runs a demonstration; returns its recording."""
    if code := demo.main(["--no-ros", "--headless", "--out", str(folder), *options]):
        raise SystemExit(code)
    return folder / "bag"


def _figure() -> tuple[Any, Any, Any, Any]:
    """A figure with a 3-D plot on the left and two plots on the right."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE_IN)
    FigureCanvasAgg(figure)
    space = figure.add_axes((-0.02, 0.1, 0.42, 0.94), projection="3d")
    upper = figure.add_axes((0.47, 0.61, 0.5, 0.29))
    lower = figure.add_axes((0.47, 0.16, 0.5, 0.29))
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("time since the first target [s]")
    return figure, space, upper, lower


def _draw_method(path: Path, name: str, curve: Curve, runs: dict[str, ReportedRun]) -> None:
    pair = ((runs[curve.beside], GREY, curve.beside), (runs[name], BLUE, name))
    with report_style():
        figure, space, upper, lower = _figure()
        row = _most_apart([reported for reported, _, _ in pair])
        points = []
        for reported, colour, label in pair:
            points.append(_arm_points(reported, row))
            space.plot(*points[-1].T, color=colour, linewidth=3.0, marker="o", markersize=3.5, label=label)
            tool = reported.run.pose_sb[:, :3, 3]
            space.plot(*tool[np.isfinite(tool).all(axis=1)].T, color=LIGHT_GREY, linewidth=1.0)
            upper.plot(*curve.values(reported), color=colour, label=label)
            lower.plot(reported.times_s, reported.metrics.null_space_series.speed, color=colour)
        ball = np.array([0.0, 0.24, 0.75])
        _draw_ball(space, ball, 0.05)
        _equal(space, np.concatenate([*points, ball[None] - 0.05, ball[None] + 0.05]))
        _caption(figure, f"At {float(pair[1][0].times_s[row]):.1f} s, where the arms differ most")
        figure.legend(*space.get_legend_handles_labels(), loc="lower left", bbox_to_anchor=(0.01, 0.06), ncols=2,
                      frameon=False, fontsize=8)  # fmt: skip
        upper.set_title(curve.title)
        lower.set_title("Null-space speed |N qd| [rad/s]")
        _share_time(upper, lower, pair[1][0])
        _save(figure, path)


def _draw_task(path: Path, runs: Sequence[ReportedRun], task: TaskTolerance, shown: Sequence[str]) -> None:
    with report_style():
        figure, space, upper, lower = _figure()
        points = [_draw_tool(space, runs[0], 0.6, 0.8), _draw_tool(space, runs[1], 1.0, 1.8)]
        _equal(space, np.concatenate(points))
        _caption(figure, "Tool along its path; pale: the whole pose exact")
        exact = [name for name in COMPONENTS if name not in shown]
        for axes, names, title in (
            (upper, shown, "Permitted deviation"),
            (lower, exact, "Exact components"),
        ):
            for name, colour in zip(names, (BLUE, VERMILION, GREEN, PURPLE, GREY, TEXT_COLOUR), strict=False):
                index = COMPONENTS.index(name)
                times, values = _deviation(runs[1], task)
                axes.plot(times, 1e3 * values[:, index], color=colour, label=name)
                width = task.half_widths[index]
                if 0.0 < width < np.inf:
                    for border in (-1e3 * width, 1e3 * width):
                        axes.axhline(border, color=colour, linewidth=0.8, linestyle="--")
            axes.set_title(f"{title} [mm, mrad]")
            axes.legend(loc="lower right", bbox_to_anchor=(1.02, 0.96), ncols=5, frameon=False, fontsize=8,
                        handlelength=0.9, columnspacing=0.8)  # fmt: skip
        lower.set_ylim(-2.0, 2.0)
        _share_time(upper, lower, runs[1])
        _save(figure, path)


def _deviation(reported: ReportedRun, task: TaskTolerance) -> tuple[Array, Array]:
    """Components of the deviation of the measured tool from the trajectory in the axes of the tolerance, (k, 6)."""
    series = reported.metrics.series
    assert series is not None
    whole = TaskTolerance(frame=task.frame)
    values = np.empty((len(series.times_s), 6))
    for row in range(len(values)):
        poses = _pose(series.measured, row), _pose(series.desired, row)
        bound, free = (task_deviation(each.form, *poses).components for each in (task, whole))
        values[row] = np.where(task.free, free, bound)
    values[~series.inside] = np.nan
    return series.times_s - reported.zero_s, values


def _pose(poses: Any, row: int) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(poses.quaternion[row])
    pose[:3, 3] = poses.position[row]
    return pose


def _most_apart(runs: Sequence[ReportedRun]) -> int:
    """Control step at which the joint positions of two runs differ most."""
    count = min(len(reported.run.q) for reported in runs)
    apart = np.linalg.norm(runs[0].run.q[:count] - runs[1].run.q[:count], axis=1)
    return int(np.nanargmax(apart))


def _arm_points(reported: ReportedRun, row: int) -> Array:
    run = reported.run
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints)
    q = np.ascontiguousarray(run.q[row])
    return np.vstack((robot.pose_base_root[:3, 3], robot.joint_origins(q), robot.pose(q)[:3, 3]))


def _draw_tool(axes: Any, reported: ReportedRun, alpha: float, width: float) -> Array:
    """Draws path and frames of the tool; returns the points."""
    series = reported.metrics.series
    assert series is not None
    rows = np.flatnonzero(series.inside & (series.times_s - series.times_s[series.inside][0] > SETTLE_S))
    path = series.measured.position[rows]
    axes.plot(*path.T, color=LIGHT_GREY, linewidth=2.0)
    length = 0.25 * float(np.ptp(path, axis=0).max())
    ends = [path]
    for row in rows[np.linspace(0, len(rows) // 2, FRAMES).astype(int)].tolist():
        pose = _pose(series.measured, row)
        for index, colour in enumerate(AXIS_COLOURS):
            line = np.stack((pose[:3, 3], pose[:3, 3] + length * pose[:3, index]))
            axes.plot(*line.T, color=colour, linewidth=width, alpha=1.0 if alpha == 1.0 else 0.35)
            ends.append(line)
    return np.concatenate(ends)


def _draw_ball(axes: Any, centre: Array, radius: float) -> None:
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    surface = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
    axes.plot_surface(*(c + radius * s for c, s in zip(centre, surface, strict=True)), color=VERMILION, alpha=0.6)


def _equal(axes: Any, points: Array) -> None:
    middle, half = 0.5 * (points.max(axis=0) + points.min(axis=0)), 0.5 * np.ptp(points, axis=0).max()
    extent = np.maximum(0.5 * np.ptp(points, axis=0), 0.4 * half)
    for set_limits, centre, size in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, extent, strict=True):
        set_limits(centre - size, centre + size)
    axes.set_box_aspect(extent, zoom=1.1)
    axes.view_init(elev=18.0, azim=-55.0)
    axes.set_axis_off()


def _caption(figure: Any, text: str) -> None:
    """Text below the 3-D plot."""
    figure.text(0.02, 0.03, text, fontsize=8.5)


def _share_time(upper: Any, lower: Any, reported: ReportedRun) -> None:
    for axes in (upper, lower):
        axes.set_xlim(0.0, reported.span_s[1])


def _save(figure: Any, path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=DPI, pil_kwargs={"quality": QUALITY})
    print(f"{path}: {path.stat().st_size / 1024:.0f} KB")

"""Tool path and arm in 3-D with obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.scene import Obstacle
from ik_node.math.types import Array
from ik_node.report.reported_run import ReportedRun
from ik_node.report.style import BLUE, GREY, LIGHT_GREY, MAX_POINTS, TEXT_COLOUR, VERMILION
from ik_node.report.tracking import TrackingSeries
from ik_node.robot.robot import Robot

MIN_ASPECT = 0.5
"""Shortest side of the drawn box, relative to the longest."""
MIN_MARGIN_M = 0.005
"""Free space around a path, which keeps the axes non-empty for a tool at rest."""


def draw_path(figure: Any, axes: Any, reported: ReportedRun) -> None:
    """Draws one run: path of the trajectory (broad), measured path coloured by its error, arm, and obstacles."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    series = reported.metrics.series
    rows = _rows(series) if series is not None else np.empty(0, np.int64)
    if series is None or len(rows) < 2:
        axes.axis("off")
        return
    desired, measured = series.desired.position[rows], series.measured.position[rows]
    arm = _draw_arm(axes, reported)
    axes.plot(*desired.T, color=LIGHT_GREY, linewidth=5.0, solid_capstyle="round", label="trajectory")
    coloured = Line3DCollection(np.stack((measured[:-1], measured[1:]), axis=1), cmap="cividis", linewidth=2.0)
    error_mm = 1e3 * series.tool_to_trajectory.position[rows]
    coloured.set_array(error_mm[:-1])
    coloured.set_clim(0.0, max(float(np.percentile(error_mm, 99.5)), 1e-6))
    axes.add_collection3d(coloured)
    axes.plot([], [], color=BLUE, linewidth=2.0, label="tool, coloured by error")
    axes.scatter(*measured[0], color=VERMILION, s=22, depthshade=False, label="start")
    obstacles = _near(reported.obstacles, np.concatenate((desired, *arm)))
    _draw_obstacles(axes, obstacles)
    _set_equal_axes(axes, np.concatenate((desired, measured, *arm, *map(_box, obstacles))), 0.03)
    bar = figure.colorbar(
        coloured, ax=axes, orientation="horizontal", shrink=0.5, pad=0.16, aspect=28, anchor=(0.5, 1.0)
    )
    bar.set_label("position error, tool to trajectory [mm]", fontsize=8)
    bar.ax.tick_params(labelsize=7.5)
    bar.ax.locator_params(nbins=5)
    bar.outline.set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=8, bbox_to_anchor=(-0.32, 1.08))


def _draw_arm(axes: Any, reported: ReportedRun) -> list[Array]:
    """Draws the arm at the start and at its smallest clearance; returns the points, (m, 3) each."""
    run, metrics = reported.run, reported.metrics
    known = np.flatnonzero(np.isfinite(run.q).all(axis=1))
    if not len(known):
        return []
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, str(run.settings.get("joint_prefix", "")))
    shown = [(int(known[0]), GREY, "arm at the start")]
    least = metrics.obstacle_clearance
    if not np.isfinite(least.least):
        least = metrics.self_clearance
    if np.isfinite(least.least):
        row = int(known[np.abs(run.times_s[known] - least.time_s).argmin()])
        text = f"arm at {least.time_s - reported.zero_s:.1f} s: {1e3 * least.least:.0f} mm, {' - '.join(least.pair)}"
        shown.append((row, TEXT_COLOUR, text))
    drawn = []
    for row, colour, label in shown:
        q = np.ascontiguousarray(run.q[row])
        points = np.vstack((robot.pose_base_root[:3, 3], robot.joint_origins(q), robot.pose(q)[:3, 3]))
        axes.plot(*points.T, color=colour, linewidth=2.2, marker="o", markersize=3.2, alpha=0.75, label=label)
        drawn.append(points)
    return drawn


def draw_paths(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Draws the measured paths of several recordings and the desired path of the first (broad)."""
    available = [
        (reported, reported.metrics.series) for reported in reported_runs if reported.metrics.series is not None
    ]
    points = []
    for index, (reported, series) in enumerate(available):
        rows = _rows(series)
        if len(rows) < 2:
            continue
        points += [series.measured.position[rows], series.desired.position[rows]]
        if index == 0:
            axes.plot(
                *points[-1].T,
                color=LIGHT_GREY,
                linewidth=6.0,
                solid_capstyle="round",
                label=f"desired, {reported.name}",
            )
        axes.plot(*points[-2].T, color=reported.colour, linewidth=1.4, label=reported.name)
        axes.scatter(*points[-2][0], color=reported.colour, s=24, depthshade=False)
    if points:
        together = np.concatenate(points)
        _set_equal_axes(axes, together, 0.06 * (float(np.ptp(together, axis=0).max()) or 0.1))
        axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.set_title("Tool paths; dots: start")


def _rows(series: TrackingSeries) -> NDArray[np.int64]:
    """Rows of the series that are drawn."""
    rows = np.flatnonzero(series.inside)
    if len(rows) < 2:
        rows = np.arange(len(series.times_s))
    return rows[:: max(1, len(rows) // MAX_POINTS)]


def _set_equal_axes(axes: Any, points: Array, margin: float) -> None:
    from matplotlib.ticker import MaxNLocator

    margin = max(margin, MIN_MARGIN_M)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    # A box that is flat in one direction would have overlapping ticks there.
    missing = np.maximum(MIN_ASPECT * float((high - low).max()) - (high - low), 0.0)
    low, high = low - 0.5 * missing, high + 0.5 * missing
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=1.05)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    for axis, size in zip((axes.xaxis, axes.yaxis, axes.zaxis), high - low, strict=True):
        axis.set_major_locator(MaxNLocator(2 if size < 0.7 * float((high - low).max()) else 4))
        axis.set_tick_params(labelsize=7.5, pad=0)
        axis.labelpad = 2
    axes.view_init(elev=22.0, azim=-52.0)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((1.0, 1.0, 1.0, 0.0))


def draw_obstacles(axes: Any, recorded: Sequence[Obstacle]) -> None:
    """Draws obstacles, as far as they are near the drawn path."""
    limits = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]).T
    obstacles = _near(recorded, limits)
    _draw_obstacles(axes, obstacles)
    _set_equal_axes(axes, np.concatenate((limits, *map(_box, obstacles))), 0.0)


def _near(obstacles: Sequence[Obstacle], points: Array) -> tuple[Obstacle, ...]:
    """The obstacles that are not farther from the box of the points (m, 3) than that extends: the others are not drawn,
    because a plot that contains them shows nothing else."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    found = []
    for entry in obstacles:
        beyond = np.maximum(np.maximum(low - entry.pose_s[:3, 3], entry.pose_s[:3, 3] - high), 0.0)
        if np.linalg.norm(beyond) < size and np.ptp(_box(entry), axis=0).max() < 2.0 * size:
            found.append(entry)
    return tuple(found)


def _box(entry: Obstacle) -> Array:
    """Least and greatest coordinates of an obstacle, (2, 3), m."""
    surface = _surface(entry).reshape(3, -1)
    return np.stack((surface.min(axis=1), surface.max(axis=1)))


def _draw_obstacles(axes: Any, obstacles: Sequence[Obstacle]) -> None:
    for entry in obstacles:
        axes.plot_surface(*_surface(entry), color=VERMILION, alpha=0.18, linewidth=0.0, shade=False)
        axes.plot_wireframe(*_surface(entry), color=VERMILION, linewidth=0.4, alpha=0.5, rstride=3, cstride=6)


def _surface(entry: Obstacle) -> Array:
    """Points on the surface of an obstacle in the base frame, (3, i, j), m."""
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, 1.0, 7))
    size = entry.shape.size
    if entry.shape.kind == "box":
        square = np.sqrt(2.0) * np.round(np.stack((np.cos(angle + np.pi / 4), np.sin(angle + np.pi / 4))), 12)
        square /= np.maximum(np.abs(square).max(axis=0), 1e-9)
        surface = np.stack((0.5 * size[0] * square[0], 0.5 * size[1] * square[1], size[2] * (height - 0.5)))
    elif entry.shape.kind == "sphere":
        horizontal, vertical = np.sin(np.pi * height), np.cos(np.pi * height)
        surface = size[0] * np.stack((horizontal * np.cos(angle), horizontal * np.sin(angle), vertical))
    else:
        surface = np.stack((size[0] * np.cos(angle), size[0] * np.sin(angle), size[1] * (height - 0.5)))
    placed: Array = np.einsum("ij,jkl->ikl", entry.pose_s[:3, :3], surface) + entry.pose_s[:3, 3][:, None, None]
    return placed

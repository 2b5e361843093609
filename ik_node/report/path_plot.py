"""The tool path in 3-D with obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.scene import read_scene
from ik_node.errors import SceneError
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.reported_run import ReportedRun
from ik_node.report.style import BLUE, GREEN, LIGHT_GREY, MAX_POINTS, VERMILION
from ik_node.report.tracking import TrackingSeries

MIN_MARGIN_M = 0.005
"""Free space around a path, which keeps the axes non-empty for a tool at rest."""


def draw_path(figure: Any, axes: Any, series: TrackingSeries) -> None:
    """Draws the desired path (broad), the measured path coloured by its error, and the z axis of the tool."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    rows = _rows(series)
    if len(rows) < 2:
        return
    desired, measured = series.desired.position[rows], series.measured.position[rows]
    axes.plot(*desired.T, color=LIGHT_GREY, linewidth=6.0, solid_capstyle="round", label="desired")
    coloured = Line3DCollection(np.stack((measured[:-1], measured[1:]), axis=1), cmap="cividis", linewidth=2.0)
    error_mm = 1e3 * series.position_error[rows]
    coloured.set_array(error_mm[:-1])
    coloured.set_clim(0.0, max(float(np.percentile(error_mm, 99.5)), 1e-6))
    axes.add_collection3d(coloured)
    axes.plot([], [], color=BLUE, linewidth=2.0, label="measured, coloured by error")
    size = float(np.ptp(desired, axis=0).max()) or 0.1
    _tool_axes(axes, series, rows, 0.13 * size)
    axes.scatter(*measured[0], color=VERMILION, s=28, depthshade=False, label="start")
    _set_equal_axes(axes, desired, 0.13 * size)
    bar = figure.colorbar(coloured, ax=axes, shrink=0.5, pad=0.10, aspect=22)
    bar.set_label("position error [mm]")
    bar.outline.set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.set_title("Tool path; green: z axis of the tool")


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


def _tool_axes(axes: Any, series: TrackingSeries, rows: NDArray[np.int64], length: float) -> None:
    """Draws the tool's z axis at about 48 evenly spaced points of the path."""
    position, quaternion = series.measured.position[rows], series.measured.quaternion[rows]
    arc_length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))))
    selected = np.unique(np.searchsorted(arc_length, np.linspace(0.0, arc_length[-1], 48)).clip(0, len(rows) - 1))
    x, y, z, w = quaternion[selected].T
    direction = np.column_stack((2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)))
    begin = position[selected]
    for first, last in zip(begin, begin + length * direction, strict=True):
        axes.plot(*np.column_stack((first, last)), color=GREEN, linewidth=0.8, alpha=0.75)


def _set_equal_axes(axes: Any, points: Array, margin: float) -> None:
    margin = max(margin, MIN_MARGIN_M)
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=1.1)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_zlabel("z [m]")
    axes.locator_params(nbins=5)
    axes.view_init(elev=22.0, azim=-38.0)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((1.0, 1.0, 1.0, 0.0))


def draw_obstacles(axes: Any, run: Run) -> None:
    """Draws the static obstacles of the run's scene file if that file still exists and can be read."""
    path = Path(str(run.settings.get("obstacles.scene", "")))
    if not path.is_file():
        return
    try:
        scene = read_scene(path)
    except SceneError:  # obstacles in frames of the arm, or a file that has changed: nothing is drawn
        return
    if not scene.obstacles:
        return
    angle, height = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, 1.0, 7))
    for entry in scene.obstacles.values():
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
        placed = np.einsum("ij,jkl->ikl", entry.pose_s[:3, :3], surface) + entry.pose_s[:3, 3][:, None, None]
        axes.plot_wireframe(*placed, color=VERMILION, linewidth=0.5, alpha=0.7)
    points = np.array([entry.pose_s[:3, 3] for entry in scene.obstacles.values()])
    for axis, limits, along in zip("xyz", (axes.get_xlim(), axes.get_ylim(), axes.get_zlim()), points.T, strict=True):
        low, high = min(limits[0], float(along.min())), max(limits[1], float(along.max()))
        getattr(axes, f"set_{axis}lim")(low, high)
    axes.set_aspect("equal")

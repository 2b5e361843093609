"""The way of the tool in 3-D, with the obstacles beside it."""

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
from ik_node.report.reported_run import Subject
from ik_node.report.style import BLUE, FAINT, GREEN, MOST_POINTS, VERMILION
from ik_node.report.tracking import Series

LEAST_MARGIN_M = 0.005
"""About a path, in every direction."""


def draw_path(figure: Any, axes: Any, series: Series) -> None:
    """Wanted path as a broad band, measured path in it coloured by its error, and where the tool points."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    rows = _rows(series)
    if len(rows) < 2:
        return
    wanted, measured = series.wanted.position[rows], series.measured.position[rows]
    axes.plot(*wanted.T, color=FAINT, linewidth=6.0, solid_capstyle="round", label="desired")
    coloured = Line3DCollection(np.stack((measured[:-1], measured[1:]), axis=1), cmap="cividis", linewidth=2.0)
    error_mm = 1e3 * series.position_error[rows]
    coloured.set_array(error_mm[:-1])
    coloured.set_clim(0.0, max(float(np.percentile(error_mm, 99.5)), 1e-6))
    axes.add_collection3d(coloured)
    axes.plot([], [], color=BLUE, linewidth=2.0, label="measured, coloured by error")
    size = float(np.ptp(wanted, axis=0).max()) or 0.1
    _tool_axes(axes, series, rows, 0.13 * size)
    axes.scatter(*measured[0], color=VERMILION, s=28, depthshade=False, label="start")
    _equal(axes, wanted, 0.13 * size)
    bar = figure.colorbar(coloured, ax=axes, shrink=0.5, pad=0.10, aspect=22)
    bar.set_label("position error [mm]")
    bar.outline.set_visible(False)
    axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.set_title("Path of the tool; ticks show where it points")


def draw_paths(axes: Any, subjects: Sequence[Subject]) -> None:
    """Several measured paths, each in its colour, over the first wanted one as a broad band."""
    known = [(subject, subject.report.series) for subject in subjects if subject.report.series is not None]
    points = []
    for index, (subject, series) in enumerate(known):
        rows = _rows(series)
        if len(rows) < 2:
            continue
        points += [series.measured.position[rows], series.wanted.position[rows]]
        if index == 0:
            axes.plot(
                *points[-1].T, color=FAINT, linewidth=6.0, solid_capstyle="round", label=f"desired, {subject.name}"
            )
        axes.plot(*points[-2].T, color=subject.colour, linewidth=1.4, label=subject.name)
        axes.scatter(*points[-2][0], color=subject.colour, s=24, depthshade=False)
    if points:
        together = np.concatenate(points)
        _equal(axes, together, 0.06 * (float(np.ptp(together, axis=0).max()) or 0.1))
        axes.legend(loc="upper left", frameon=False, fontsize=8)
    axes.set_title("Paths of the tool; a dot is where each begins")


def _rows(series: Series) -> NDArray[np.int64]:
    """Which moments are drawn."""
    rows = np.flatnonzero(series.inside)
    if len(rows) < 2:
        rows = np.arange(len(series.times_s))
    return rows[:: max(1, len(rows) // MOST_POINTS)]


def _tool_axes(axes: Any, series: Series, rows: NDArray[np.int64], length: float) -> None:
    """The tool's z axis at about 48 places evenly along the path."""
    position, quaternion = series.measured.position[rows], series.measured.quaternion[rows]
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))))
    picked = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], 48)).clip(0, len(rows) - 1))
    x, y, z, w = quaternion[picked].T
    direction = np.column_stack((2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)))
    begin = position[picked]
    for first, last in zip(begin, begin + length * direction, strict=True):
        axes.plot(*np.column_stack((first, last)), color=GREEN, linewidth=0.8, alpha=0.75)


def _equal(axes: Any, points: Array, margin: float) -> None:
    margin = max(margin, LEAST_MARGIN_M)  # a tool that hardly moved has a place too
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
    """The obstacles of the scene file that the run was given, where it still lies where it was; those at rest."""
    path = Path(str(run.settings.get("obstacles.scene", "")))
    if not path.is_file():
        return
    try:
        scene = read_scene(path)
    except SceneError:  # in frames of the arm, or changed since: the picture goes without
        return
    if not scene.obstacles:
        return
    turn, rise = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, 1.0, 7))
    for entry in scene.obstacles.values():
        size = entry.shape.size
        if entry.shape.kind == "box":
            square = np.sqrt(2.0) * np.round(np.stack((np.cos(turn + np.pi / 4), np.sin(turn + np.pi / 4))), 12)
            square /= np.maximum(np.abs(square).max(axis=0), 1e-9)
            solid = np.stack((0.5 * size[0] * square[0], 0.5 * size[1] * square[1], size[2] * (rise - 0.5)))
        elif entry.shape.kind == "sphere":
            around, up = np.sin(np.pi * rise), np.cos(np.pi * rise)
            solid = size[0] * np.stack((around * np.cos(turn), around * np.sin(turn), up))
        else:
            solid = np.stack((size[0] * np.cos(turn), size[0] * np.sin(turn), size[1] * (rise - 0.5)))
        placed = np.einsum("ij,jkl->ikl", entry.pose_s[:3, :3], solid) + entry.pose_s[:3, 3][:, None, None]
        axes.plot_wireframe(*placed, color=VERMILION, linewidth=0.5, alpha=0.7)
    points = np.array([entry.pose_s[:3, 3] for entry in scene.obstacles.values()])
    for axis, limits, along in zip("xyz", (axes.get_xlim(), axes.get_ylim(), axes.get_zlim()), points.T, strict=True):
        low, high = min(limits[0], float(along.min())), max(limits[1], float(along.max()))
        getattr(axes, f"set_{axis}lim")(low, high)
    axes.set_aspect("equal")

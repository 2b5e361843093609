"""A run in one picture: path, errors, joint velocities, singular value and scale, and what the controller was doing.

Colours are those of Okabe and Ito (and cividis), which people with any colour vision tell apart.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import RecordingError, SceneError
from ik_node.recording.run import Run
from ik_node.report.figures import Nearness, Report, part_of_limit
from ik_node.report.text import as_text, title
from ik_node.report.tracking import Series
from ik_node.scene import read_scene
from ik_node.se3 import Array
from ik_node.step import Mode

INK = "#222222"
FAINT = "#c8ccd0"
BLUE = "#0072b2"
VERMILION = "#d55e00"
GREEN = "#009e73"
MODE_COLOURS = {
    Mode.WAITING: "#bbbbbb",
    Mode.HOLDING: "#56b4e9",
    Mode.TRACKING: "#009e73",
    Mode.RAMPING: "#f0e442",
    Mode.PAUSED: "#e69f00",
    Mode.STOPPED: "#d55e00",
    Mode.FAULT: "#000000",
}
STYLE: Any = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": "#e6e8ea",
    "lines.linewidth": 1.1,
}
MOST_POINTS = 4000
"""Per line; beyond that the extremes of neighbouring points are drawn."""


def draw(run: Run, report: Report, path: str | Path) -> None:
    """Writes the picture as PNG (or SVG or PDF, by the name's ending).

    Raises RecordingError when matplotlib is not installed or the file cannot be written.
    """
    try:
        import matplotlib as mpl  # only here: everything else works without it
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise RecordingError("pictures need matplotlib, which is not installed") from error
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(14.0, 9.2))
        FigureCanvasAgg(figure)
        _compose(figure, run, report)
        try:
            figure.savefig(Path(path), dpi=110)
        except (OSError, ValueError) as error:
            raise RecordingError(f"the picture cannot be written: {error}") from error


def _compose(figure: Any, run: Run, report: Report) -> None:
    figure.suptitle(title(report), x=0.03, y=0.975, ha="left", fontsize=15, fontweight="bold")
    outer = figure.add_gridspec(
        1, 2, width_ratios=(0.82, 1.0), left=0.03, right=0.975, top=0.915, bottom=0.06, wspace=0.12
    )
    left = outer[0].subgridspec(2, 1, height_ratios=(1.0, 0.58), hspace=0.06)
    joints = len(run.joints)
    right = outer[1].subgridspec(6, 1, height_ratios=(0.9, 0.9, 0.34 * joints, 0.8, 0.6, 0.28), hspace=0.36)
    if report.series is not None:
        axes = figure.add_subplot(left[0], projection="3d")
        _path(figure, axes, report.series)
        _obstacles(axes, run)
    _figures(figure.add_subplot(left[1]), report)
    first = figure.add_subplot(right[0])
    if report.tracking is not None and report.series is not None:
        second = figure.add_subplot(right[1], sharex=first)
        tracking, series = report.tracking, report.series
        _error(first, series, 1e3 * series.position_error, tracking.settled.position_rms_mm, "Position error [mm]")
        _error(
            second,
            series,
            1e3 * series.orientation_error,
            tracking.settled.orientation_rms_mrad,
            "Orientation error [mrad]",
        )
    strips = right[2].subgridspec(joints, 1, hspace=0.12)
    _velocities([figure.add_subplot(strips[index], sharex=first) for index in range(joints)], run)
    _conditioning(figure.add_subplot(right[3], sharex=first), run)
    _clearance(figure.add_subplot(right[4], sharex=first), run, report.nearness)
    timeline = figure.add_subplot(right[5], sharex=first)
    _timeline(timeline, run)
    for axes in figure.axes:
        if axes is not timeline and axes.get_shared_x_axes().joined(axes, timeline):
            axes.tick_params(labelbottom=False)
    if len(run.times_s):
        first.set_xlim(0.0, float(run.times_s[-1]))


def _path(figure: Any, axes: Any, series: Series) -> None:
    """Wanted path as a broad band, measured path in it coloured by its error, and where the tool points."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]

    rows = np.flatnonzero(series.inside)
    if len(rows) < 2:
        rows = np.arange(len(series.times_s))
    rows = rows[:: max(1, len(rows) // MOST_POINTS)]
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


def _figures(axes: Any, report: Report) -> None:
    """The report's text, without its title."""
    axes.axis("off")
    text = "\n".join(as_text(report).splitlines()[1:])
    axes.text(0.0, 0.98, text, family="monospace", fontsize=7.6, va="top", linespacing=1.45, transform=axes.transAxes)


def _error(axes: Any, series: Series, values: Array, rms: float, label: str) -> None:
    shown = np.where(series.inside, values, np.nan)
    times, thinned = thin(series.times_s, shown)
    axes.fill_between(times, thinned, color=BLUE, alpha=0.18, linewidth=0)
    axes.plot(times, thinned, color=BLUE)
    if np.isfinite(rms):
        axes.axhline(rms, color=VERMILION, linewidth=1.0, linestyle="--")
        axes.annotate(
            f"RMS {rms:.3g}", (1.0, rms), xycoords=("axes fraction", "data"), color=VERMILION, ha="right", va="bottom"
        )
    axes.set_ylim(bottom=0.0)
    axes.set_title(label)


def _velocities(strips: list[Any], run: Run) -> None:
    """One strip per joint: the command between its limits."""
    parts = 100.0 * part_of_limit(run)
    for index, (axes, name) in enumerate(zip(strips, run.joints, strict=True)):
        times, values = thin(run.times_s, parts[:, index])
        axes.axhspan(100.0, 130.0, color=VERMILION, alpha=0.25, linewidth=0)
        axes.axhspan(-130.0, -100.0, color=VERMILION, alpha=0.25, linewidth=0)
        axes.fill_between(times, values, color=BLUE, alpha=0.3, linewidth=0)
        axes.plot(times, values, color=BLUE, linewidth=0.9)
        axes.set_ylim(-118.0, 118.0)
        axes.set_yticks([0.0])
        axes.set_yticklabels([name], fontsize=7.5)
        peak = np.nanmax(np.abs(parts[:, index])) if len(parts) else 0.0
        axes.annotate(
            f"{peak:.0f} %", (1.005, 0.5), xycoords="axes fraction", ha="left", va="center", fontsize=8, color=INK
        )
    strips[0].set_title("Joint velocity commands between their limits (shaded); peak in % of the limit at the right")


def _conditioning(axes: Any, run: Run) -> None:
    """Least singular value with the threshold of fading, and the scale s on its own axis."""
    times, values = thin(run.times_s, run.singular_values[:, -1])
    axes.plot(times, values, color=BLUE)
    threshold = run.settings.get("singularity.threshold")
    if isinstance(threshold, float):
        axes.axhline(threshold, color=VERMILION, linewidth=1.0, linestyle="--")
        axes.annotate(
            "looked after below",
            (0.005, threshold),
            xycoords=("axes fraction", "data"),
            color=VERMILION,
            va="bottom",
        )
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel("m", color=BLUE)
    scale = axes.twinx()
    scale.grid(visible=False)
    scale.plot(*thin(run.times_s, run.scale), color=INK, linewidth=1.0)
    scale.set_ylim(0.0, 1.08)
    scale.set_ylabel("s", rotation=0)
    axes.set_title("Least singular value of the Jacobian (blue) and scale s (black)")


def _clearance(axes: Any, run: Run, nearness: Nearness) -> None:
    """Distance of the closest pair over time."""
    axes.set_title("Clearance [mm]")
    if not np.isfinite(nearness.least):
        axes.annotate("not measured", (0.5, 0.4), xycoords="axes fraction", ha="center", color=INK)
        axes.set_yticks([])
        return
    known = np.isfinite(run.clearance)
    axes.plot(*thin(run.times_s[known], 1e3 * run.clearance[known]), color=BLUE)
    axes.axhline(0.0, color=VERMILION, linewidth=1.0)
    axes.set_title(f"Clearance [mm]; least between {' and '.join(nearness.pair)}")


def _obstacles(axes: Any, run: Run) -> None:
    """The obstacles of the scene file that the run was given, where it still lies where it was; those at rest."""
    path = Path(str(run.settings.get("obstacles.scene", "")))
    if not path.is_file():
        return
    try:
        scene = read_scene(path)
    except SceneError:  # in frames of the arm, or changed since: the picture goes without
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


def _timeline(axes: Any, run: Run) -> None:
    """What the controller was doing, and why."""
    moments = [change.time_s for change in run.statuses]
    ends = [*moments[1:], float(run.times_s[-1])] if moments else []
    used: list[Mode] = []
    for change, end in zip(run.statuses, ends, strict=True):
        mode = change.status.mode
        used += [mode] if mode not in used else []
        axes.axvspan(max(change.time_s, 0.0), end, color=MODE_COLOURS[mode], linewidth=0)
    handles = [_patch(mode) for mode in used]
    if handles:
        axes.legend(
            handles=handles,
            loc="lower right",
            bbox_to_anchor=(1.0, 0.98),
            ncols=len(handles),
            frameon=False,
            fontsize=8,
        )
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.set_title("Controller")
    axes.set_xlabel("time [s]")


def _patch(mode: Mode) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=MODE_COLOURS[mode], label=mode.value)


def thin(times: Array, values: Array) -> tuple[Array, Array]:
    """At most about ``MOST_POINTS`` points that keep every peak: the least and the largest of each run of neighbours.

    A run that holds NaN only stays NaN.
    """
    if len(times) <= MOST_POINTS:
        return times, values
    width = -(-2 * len(times) // MOST_POINTS)
    whole = len(times) // width * width
    blocks = values[:whole].reshape(-1, width)
    finite = np.isfinite(blocks)
    low, high = np.where(finite, blocks, np.inf).argmin(axis=1), np.where(finite, blocks, -np.inf).argmax(axis=1)
    base = np.arange(0, whole, width)
    rows = np.sort(np.stack((base + low, base + high), axis=1), axis=1).ravel()
    rows = np.concatenate((rows, np.arange(whole, len(times))))
    return times[rows], values[rows]

"""A run in one picture: path, errors, joint velocities, singular value and scale, and what the controller was doing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.canvas import drawing, new_figure, saving
from ik_node.report.metrics import Nearness, Report, part_of_limit
from ik_node.report.path_plot import draw_obstacles, draw_path
from ik_node.report.reported_run import subject_of
from ik_node.report.style import BLUE, DPI, INK, MODE_COLOURS, VERMILION, thin
from ik_node.report.text import as_text, title
from ik_node.report.timeline import draw_bands
from ik_node.report.tracking import Series

__all__ = ["MODE_COLOURS", "draw", "overview"]


def draw(run: Run, report: Report, path: str | Path) -> None:
    """Writes the picture as PNG (or SVG or PDF, by the name's ending).

    Raises RecordingError when matplotlib is not installed or the file cannot be written.
    """
    with drawing():
        figure = overview(run, report)
        with saving():
            figure.savefig(Path(path), dpi=DPI)


def overview(run: Run, report: Report) -> Any:
    """The page that is drawn; to be called while :func:`~ik_node.report.canvas.drawing` lasts."""
    figure = new_figure(9.2)
    _compose(figure, run, report)
    return figure


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
        draw_path(figure, axes, report.series)
        draw_obstacles(axes, run)
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
    draw_bands(timeline, [subject_of(run, report)])
    timeline.set_xlabel("time [s]")
    for axes in figure.axes:
        if axes is not timeline and axes.get_shared_x_axes().joined(axes, timeline):
            axes.tick_params(labelbottom=False)
    if len(run.times_s):
        first.set_xlim(0.0, float(run.times_s[-1]))


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

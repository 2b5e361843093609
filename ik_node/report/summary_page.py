"""One run on one page: verdict, arm and path, metrics, errors, joint velocities, scale, clearance and states."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.collision.scene import Obstacle
from ik_node.interfaces.step import smallest_singular_value
from ik_node.recording.run import Run
from ik_node.report import quantities
from ik_node.report.canvas import convert_write_errors, new_figure, report_style
from ik_node.report.curves import draw_clearance, draw_scale, draw_tracking_error
from ik_node.report.metrics import RunMetrics
from ik_node.report.path_plot import draw_path
from ik_node.report.reported_run import ReportedRun, report_run, time_label
from ik_node.report.run_description import joint_units
from ik_node.report.style import AMBER, DPI, TEXT_COLOUR, VERMILION, decimate
from ik_node.report.task_components import HEIGHT_IN as COMPONENT_IN
from ik_node.report.task_components import draw_task_components, loose_components
from ik_node.report.text import metric_lines, what_was_done
from ik_node.report.timeline import draw_mode_bars
from ik_node.report.verdict import CAUSE_COLOURS, verdict

HEIGHT_IN = 10.6
LINE_IN = 0.148
"""Of the metrics as text."""
TEXT_IN = 9.2
"""Height of the left half."""
SHORTEST_PATH_IN = 3.4
"""Of it at least left for arm and path."""
REST = 1e-6
"""Velocities below this (rad/s, m/s) are rounding."""
VERDICT_CHARACTERS = 118


def save_summary(run: Run, metrics: RunMetrics, path: str | Path, obstacles: tuple[Obstacle, ...] = ()) -> None:
    """Writes the summary page of one run.

    Args:
        run: The recorded run.
        metrics: Its metrics.
        path: The file; its suffix (png, svg, pdf) selects the format.
        obstacles: Obstacles to draw.

    Raises:
        MissingPackageError: matplotlib is not installed.
        RecordingError: The file cannot be written.
    """
    with report_style():
        figure = draw_summary(report_run(run, metrics)._replace(obstacles=obstacles))
        with convert_write_errors():
            figure.savefig(Path(path), dpi=DPI)


def draw_summary(reported: ReportedRun) -> Any:
    """Draws the page; call it within :func:`~ik_node.report.canvas.report_style`."""
    run, metrics = reported.run, reported.metrics
    figure = new_figure(HEIGHT_IN)
    _draw_verdict(figure, metrics)
    outer = figure.add_gridspec(
        1, 2, width_ratios=(0.86, 1.0), left=0.03, right=0.91, top=0.865, bottom=0.05, wspace=0.14
    )
    lines = metric_lines(metrics)
    text_in = LINE_IN * (1.0 + len(lines))
    left = outer[0].subgridspec(2, 1, height_ratios=(max(TEXT_IN - text_in, SHORTEST_PATH_IN), text_in), hspace=0.02)
    joints = len(run.joints)
    loose = len(loose_components([reported]))
    within = [COMPONENT_IN * loose] if loose else []
    heights = (0.95, 0.95, *within, 0.3 * joints, 0.62, 0.5, 0.62, 0.26)
    right = list(outer[1].subgridspec(len(heights), 1, height_ratios=heights, hspace=0.42))
    if metrics.series is not None:
        draw_path(figure, figure.add_subplot(left[0], projection="3d"), reported)
    _draw_text(figure.add_subplot(left[1]), "\n".join(lines))
    first = figure.add_subplot(right[0])
    draw_tracking_error(first, [reported], quantities.POSITION_ERROR)
    draw_tracking_error(figure.add_subplot(right[1], sharex=first), [reported], quantities.ORIENTATION_ERROR)
    if loose:
        rows = right.pop(2).subgridspec(loose, 1, hspace=0.16)
        draw_task_components([figure.add_subplot(rows[index], sharex=first) for index in range(loose)], [reported])
    rows = right[2].subgridspec(joints, 1, hspace=0.16)
    _draw_joint_velocities([figure.add_subplot(rows[index], sharex=first) for index in range(joints)], reported)
    _draw_singular_value(figure.add_subplot(right[3], sharex=first), reported)
    draw_scale(figure.add_subplot(right[4], sharex=first), [reported])
    draw_clearance(figure.add_subplot(right[5], sharex=first), [reported])
    modes = figure.add_subplot(right[6], sharex=first)
    draw_mode_bars(modes, [reported])
    modes.set_xlabel(time_label([reported]))
    for axes in figure.axes:
        if axes is not modes and axes.get_shared_x_axes().joined(axes, modes):
            axes.tick_params(labelbottom=False)
    if len(run.times_s):
        first.set_xlim(*reported.span_s)
    return figure


def _draw_verdict(figure: Any, metrics: RunMetrics) -> None:
    """The verdict beside a bar in the colour of its cause, and below it what was done."""
    found = verdict(metrics)
    lines = textwrap.wrap(found.text, VERDICT_CHARACTERS)[:2]
    size = 15 if len(lines) == 1 and len(lines[0]) < 90 else 12
    from matplotlib.patches import Rectangle

    colour = CAUSE_COLOURS.get(found.cause, AMBER)
    figure.add_artist(Rectangle((0.03, 0.922), 0.005, 0.058, transform=figure.transFigure, color=colour))
    place: Any = {"ha": "left", "va": "top"}
    figure.text(0.045, 0.98, "\n".join(lines), fontsize=size, fontweight="bold", linespacing=1.3, **place)
    figure.text(0.045, 0.936, what_was_done(metrics), fontsize=10, color="#556", **place)


def _draw_text(axes: Any, text: str) -> None:
    """The metrics as text."""
    axes.axis("off")
    axes.text(0.0, 0.98, text, family="monospace", fontsize=7.4, va="top", linespacing=1.4, transform=axes.transAxes)


def _draw_joint_velocities(rows: list[Any], reported: ReportedRun) -> None:
    """Velocity commands of all joints, each with a scale of its own; beyond the limit the plot is shaded."""
    run = reported.run
    place: Any = {"xycoords": "axes fraction", "ha": "left", "va": "center"}
    units = joint_units(run)
    for index, (axes, joint) in enumerate(zip(rows, run.joints, strict=True)):
        values, limit = run.joint_velocity[:, index], float(run.velocity_limits[index])
        finite = np.abs(values[np.isfinite(values)])
        peak = float(finite.max(initial=0.0))
        times, shown = decimate(reported.times_s, values)
        axes.fill_between(times, shown, color=reported.colour, alpha=0.3, linewidth=0)
        axes.plot(times, shown, color=reported.colour, linewidth=0.9)
        span = 1.25 * max(peak, 1e-3)
        for sign in (-1.0, 1.0):
            axes.axhspan(sign * limit, sign * 10.0 * limit, color=VERMILION, alpha=0.25, linewidth=0)
        axes.set_ylim(-span, span)
        axes.set_yticks([0.0])
        axes.set_yticklabels([joint], fontsize=7.5)
        part = f", {100.0 * peak / limit:.0f} %" if np.isfinite(limit) and limit > 0.0 else ""
        shown_peak = f"{peak:.2g}" if peak > REST else "0"
        axes.annotate(f"{shown_peak} {units[index]}/s{part}", (1.005, 0.5), fontsize=7.5, color=TEXT_COLOUR, **place)
    rows[0].set_title("Joint velocity commands, each to its own scale; right: peak, and % of the limit")


def _draw_singular_value(axes: Any, reported: ReportedRun) -> None:
    """The smallest singular value, with the threshold of regulation where it is near."""
    run, quantity = reported.run, quantities.SMALLEST_SINGULAR_VALUE
    axes.plot(*decimate(reported.times_s, smallest_singular_value(run.singular_values)), color=reported.colour)
    threshold = run.settings.get("singularity.threshold")
    below = ""
    if isinstance(threshold, float):
        axes.axhline(threshold, color=VERMILION, linewidth=1.0, linestyle="--")
        below = "; regulated below the dashed line"
    axes.set_ylim(bottom=0.0)
    axes.set_title(f"Smallest singular value of the Jacobian [{quantity.unit}]{below}")

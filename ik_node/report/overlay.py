"""Comparison of several recordings on one page: paths, metrics, errors, scale, clearance and states."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from ik_node.report import quantities
from ik_node.report.canvas import new_figure
from ik_node.report.curves import draw_clearance, draw_scale, draw_singular_values, draw_tracking_error
from ik_node.report.path_plot import draw_obstacles, draw_paths
from ik_node.report.reported_run import ReportedRun, span_of, time_label
from ik_node.report.style import page_heading, run_legend, share_time_axis
from ik_node.report.table import MAIN_LABELS, as_table
from ik_node.report.task_components import HEIGHT_IN as COMPONENT_IN
from ik_node.report.task_components import draw_task_components, loose_components
from ik_node.report.timeline import draw_mode_bars
from ik_node.report.verdict import verdict

VERDICT_CHARACTERS = 72
LINE_PART = 0.036
"""Height of a line of a verdict, relative to the text."""
COLUMN = 18
"""Maximum width of the metrics of one recording, in characters."""


def _write_verdicts(axes: Any, reported_runs: Sequence[ReportedRun]) -> float:
    """The verdict of every recording in its colour; returns the height of the end of the text."""
    y = 0.97
    for reported in reported_runs:
        lines = textwrap.wrap(
            f"{reported.name}: {verdict(reported.metrics, reported.zero_s).text}", VERDICT_CHARACTERS
        )[:3]
        axes.text(0.0, y, "\n".join(lines), color=reported.colour, fontsize=9.5, fontweight="bold", va="top")
        y -= LINE_PART * (len(lines) + 0.4)
    return y


TABLE_PT, TABLE_WIDTH_PT = 7.6, 700.0
"""Largest size of the letters of the table, and that of one letter per line that is as wide as the half of the page."""


def draw_overlay(reported_runs: Sequence[ReportedRun]) -> Any:
    """Draws the page."""
    figure = new_figure(12.2)
    page_heading(figure, "Comparison")
    run_legend(figure, [(reported.name, reported.colour) for reported in reported_runs])
    halves = figure.add_gridspec(
        1, 2, width_ratios=(0.82, 1.0), left=0.03, right=0.985, top=0.935, bottom=0.05, wspace=0.16
    )
    left = halves[0].subgridspec(2, 1, height_ratios=(0.75, 1.0), hspace=0.04)
    if any(reported.metrics.series is not None for reported in reported_runs):
        axes = figure.add_subplot(left[0], projection="3d")
        draw_paths(axes, reported_runs)
        draw_obstacles(axes, reported_runs[0].obstacles)
    table = figure.add_subplot(left[1])
    table.axis("off")
    end = _write_verdicts(table, reported_runs)
    text = as_table(reported_runs, COLUMN, MAIN_LABELS)
    size = min(TABLE_PT, TABLE_WIDTH_PT / max(map(len, text.splitlines())))
    table.text(0.0, end - LINE_PART, text, family="monospace", fontsize=size, va="top", linespacing=1.4)
    bars = 0.22 + 0.16 * len(reported_runs)
    loose = len(loose_components(reported_runs))
    within = [COMPONENT_IN * loose] if loose else []
    heights = (1.0, 1.0, *within, 0.8, 0.6, 0.8, bars)
    rows = list(halves[1].subgridspec(len(heights), 1, height_ratios=heights, hspace=0.34))
    parts = rows.pop(2).subgridspec(loose, 1, hspace=0.16) if loose else ()
    components = [figure.add_subplot(parts[index]) for index in range(loose)]
    draw_task_components(components, reported_runs)
    column = [figure.add_subplot(row) for row in rows]
    draw_tracking_error(column[0], reported_runs, quantities.POSITION_ERROR)
    draw_tracking_error(column[1], reported_runs, quantities.ORIENTATION_ERROR)
    draw_singular_values(column[2], reported_runs)
    draw_scale(column[3], reported_runs)
    draw_clearance(column[4], reported_runs)
    draw_mode_bars(column[5], reported_runs)
    share_time_axis([*components, *column], span_of(reported_runs), time_label(reported_runs))
    return figure

"""Several recordings in one picture: paths, figures side by side, errors, what slowed them, and their states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.report.canvas import new_figure
from ik_node.report.path_plot import draw_obstacles, draw_paths
from ik_node.report.reported_run import Subject, span_of, time_label
from ik_node.report.solver_page import draw_clearance, draw_scale, draw_singular_values
from ik_node.report.style import heading, names_on, only_last_has_times, remark, thin
from ik_node.report.table import as_table
from ik_node.report.timeline import draw_bands

COLUMN = 16
"""Letters of a recording's column of figures."""


def draw_overlay(subjects: Sequence[Subject]) -> Any:
    """The page."""
    figure = new_figure(12.2)
    heading(figure, "Comparison")
    names_on(figure, [(subject.name, subject.colour) for subject in subjects])
    halves = figure.add_gridspec(
        1, 2, width_ratios=(0.82, 1.0), left=0.03, right=0.985, top=0.935, bottom=0.05, wspace=0.16
    )
    left = halves[0].subgridspec(2, 1, height_ratios=(0.75, 1.0), hspace=0.04)
    if any(subject.report.series is not None for subject in subjects):
        axes = figure.add_subplot(left[0], projection="3d")
        draw_paths(axes, subjects)
        draw_obstacles(axes, subjects[0].run)
    words = figure.add_subplot(left[1])
    words.axis("off")
    small = 6.9 if len(subjects) <= 3 else 5.9
    words.text(0.0, 1.0, as_table(subjects, COLUMN), family="monospace", fontsize=small, va="top", linespacing=1.35)
    bands = 0.22 + 0.16 * len(subjects)
    rows = halves[1].subgridspec(6, 1, height_ratios=(1.0, 1.0, 0.8, 0.6, 0.8, bands), hspace=0.34)
    column = [figure.add_subplot(rows[index]) for index in range(6)]
    _errors(column[0], subjects, "position_error", "Position error [mm]")
    _errors(column[1], subjects, "orientation_error", "Orientation error [mrad]")
    draw_singular_values(column[2], subjects)
    draw_scale(column[3], subjects)
    draw_clearance(column[4], subjects)
    draw_bands(column[5], subjects)
    only_last_has_times(column, span_of(subjects), time_label(subjects))
    return figure


def _errors(axes: Any, subjects: Sequence[Subject], field: str, label: str) -> None:
    axes.set_title(label)
    lines = 0
    for subject in subjects:
        series = subject.report.series
        if series is not None:
            shown = np.where(series.inside, 1e3 * getattr(series, field), np.nan)
            axes.plot(*thin(series.times_s - subject.zero_s, shown), color=subject.colour)
            lines += 1
    if lines:
        axes.set_ylim(bottom=0.0)
    else:
        remark(axes, "nothing to compare with: no trajectory beside the recordings, no targets in them")

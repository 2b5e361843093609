"""Control periods, computing times, ages of the targets, hold-ups, and the controller's states with their reasons."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.report.canvas import new_figure
from ik_node.report.lateness import hold_ups, target_age_s
from ik_node.report.reported_run import ReportedRun, span_of, time_label
from ik_node.report.style import decimate, page_heading, run_legend
from ik_node.report.timeline import draw_mode_bars, draw_numbers, number_of_reason_lines, write_reasons

BINS = 80
HEADROOM = 1.08
"""End of an axis from 0, relative to the largest value: a constant line is not on the border."""
MIN_BIN_WIDTH_MS = 0.02
REASON_LINES = 36
PLOTS_IN = 1.7
"""Height of a row of plots."""
COLUMNS = 2
LINE_IN = 0.14
HEADING_IN = 0.75
GAP_IN = 0.7
"""Between two rows."""
LINE_CHARACTERS = 190
"""Of a list of reasons as wide as the page."""


def draw_states(reported_runs: Sequence[ReportedRun]) -> Any:
    """Draws the page: the plots that have data, mode bars, and the list of reasons."""
    width = LINE_CHARACTERS // len(reported_runs) - 2
    lines = min(REASON_LINES, 2 + max(number_of_reason_lines(reported, width) for reported in reported_runs))
    bars = 0.32 + 0.2 * len(reported_runs)
    plots = _plots_with_data(reported_runs)
    pairs = [plots[index : index + COLUMNS] for index in range(0, len(plots), COLUMNS)]
    heights = (*[PLOTS_IN] * len(pairs), bars, LINE_IN * lines)
    height = sum(heights) + HEADING_IN + GAP_IN * (len(heights) - 1)
    figure = new_figure(height)
    page_heading(figure, "Timing and states")
    if len(reported_runs) > 1:
        run_legend(figure, [(reported.name, reported.colour) for reported in reported_runs])
    rows = figure.add_gridspec(
        len(heights),
        1,
        height_ratios=heights,
        left=0.07,
        right=0.985,
        top=1.0 - HEADING_IN / height,
        bottom=0.0,
        hspace=GAP_IN * len(heights) / sum(heights),
    )
    for row, pair in enumerate(pairs):
        cells = rows[row].subgridspec(1, len(pair), wspace=0.12)
        for column, draw in enumerate(pair):
            draw(figure.add_subplot(cells[column]), reported_runs)
    axes = figure.add_subplot(rows[-2])
    draw_mode_bars(axes, reported_runs, numbered=True)
    axes.set_xlim(*_non_empty(span_of(reported_runs)))
    axes.set_xlabel(time_label(reported_runs))
    axes.set_title("Controller; the numbers refer to the reasons below")
    draw_numbers(axes, reported_runs)
    columns = rows[-1].subgridspec(1, len(reported_runs), wspace=0.04)
    for index, reported in enumerate(reported_runs):
        reasons = figure.add_subplot(columns[index])
        if len(reported_runs) > 1:
            reasons.set_title(reported.name, color=reported.colour)
        write_reasons(reasons, reported, lines, width)
    return figure


def _plots_with_data(reported_runs: Sequence[ReportedRun]) -> list[Callable[[Any, Sequence[ReportedRun]], None]]:
    """The plots of the page, without those that would be empty."""
    has_periods = any(len(reported.run.times_s) > 1 for reported in reported_runs)
    has_hold_ups = any(len(hold_ups(reported.run).end_s) for reported in reported_runs)
    has_targets = any(np.isfinite(target_age_s(reported.run)).any() for reported in reported_runs)
    has_computing = any(np.isfinite(reported.run.computing_s).any() for reported in reported_runs)
    plots = (
        (_histogram, has_periods),
        (_periods, has_periods),
        (_computing_histogram, has_computing),
        (_computing, has_computing),
        (_target_age, has_targets),
        (_hold_ups, has_hold_ups),
    )
    return [draw for draw, has_data in plots if has_data]


def _non_empty(span: tuple[float, float]) -> tuple[float, float]:
    return span if span[1] > span[0] else (span[0], span[0] + 1.0)


def _histogram(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Histogram of the control periods."""
    axes.set_title("Control period [ms]; dashed: median")
    periods = [1e3 * np.diff(reported.run.times_s) for reported in reported_runs]
    together = np.concatenate(periods)
    low, high = float(together.min()), float(together.max())
    width = max((high - low) / BINS, MIN_BIN_WIDTH_MS)
    edges = np.arange(low - 0.5 * width, high + 1.5 * width, width)
    for reported, values in zip(reported_runs, periods, strict=True):
        if not len(values):
            continue
        filled = {"histtype": "stepfilled", "alpha": 0.55} if len(reported_runs) == 1 else {"histtype": "step"}
        axes.hist(values, bins=edges, color=reported.colour, linewidth=1.2, **filled)
        axes.axvline(float(np.median(values)), color=reported.colour, linewidth=1.0, linestyle="--")
    axes.set_yscale("log")
    axes.set_ylabel("control steps")


def _computing_histogram(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Histogram of the computing times, from the call of the controller to the published command."""
    axes.set_title("Computing time [ms]; dashed: median")
    known = [(reported, _computing_ms(reported)) for reported in reported_runs]
    known = [(reported, values[np.isfinite(values)]) for reported, values in known if np.isfinite(values).any()]
    edges = np.linspace(0.0, max(float(values.max()) for _, values in known), BINS + 1)
    for reported, values in known:
        axes.hist(values, bins=edges, color=reported.colour, linewidth=1.2, histtype="step")
        axes.axvline(float(np.median(values)), color=reported.colour, linewidth=1.0, linestyle="--")
    axes.set_yscale("log")
    axes.set_ylabel("control steps")


def _computing(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    axes.set_title("Computing time [ms] over time")
    for reported in reported_runs:
        axes.plot(*decimate(reported.times_s, _computing_ms(reported)), color=reported.colour, linewidth=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(*_non_empty(span_of(reported_runs)))
    axes.set_xlabel(time_label(reported_runs))


def _computing_ms(reported: ReportedRun) -> Array:
    result: Array = 1e3 * reported.run.computing_s
    return result


def _periods(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    axes.set_title("Control period [ms] over time")
    for reported in reported_runs:
        if len(reported.run.times_s) > 1:
            values = decimate(reported.times_s[1:], 1e3 * np.diff(reported.run.times_s))
            axes.plot(*values, color=reported.colour, linewidth=0.8)
    axes.set_ylim(0.0, HEADROOM * axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) else None)
    axes.set_xlim(*_non_empty(span_of(reported_runs)))
    axes.set_xlabel(time_label(reported_runs))


def _target_age(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    axes.set_title("Age of the newest target at each control step [ms]")
    for reported in reported_runs:
        axes.plot(*decimate(reported.times_s, 1e3 * target_age_s(reported.run)), color=reported.colour, linewidth=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(*_non_empty(span_of(reported_runs)))
    axes.set_xlabel(time_label(reported_runs))


def _hold_ups(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """One line per hold-up, at its end."""
    axes.set_title("Hold-ups: times in which the node made no call [ms]")
    for reported in reported_runs:
        entry = hold_ups(reported.run)
        axes.vlines(entry.end_s - reported.zero_s, 0.0, 1e3 * entry.duration_s, color=reported.colour, linewidth=1.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(*_non_empty(span_of(reported_runs)))
    axes.set_xlabel(time_label(reported_runs))

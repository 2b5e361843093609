"""When the controller ran, what it was doing and why."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.report.canvas import new_figure
from ik_node.report.reported_run import Subject, span_of, time_label
from ik_node.report.style import GREY, heading, names_on, remark, thin
from ik_node.report.timeline import draw_bands, draw_numbers, entries, write_reasons

BINS = 80
LEAST_WIDTH_MS = 0.02
"""Of a bin."""
REASON_LINES = 36
LINE_CHARACTERS = 190
"""Of a line of reasons that is as wide as the page."""


def draw_states(subjects: Sequence[Subject]) -> Any:
    """The page: times between ticks, bands of the states, the reasons one by one."""
    lines = min(REASON_LINES, 2 + 2 * max(len(entries(subject)) for subject in subjects))
    figure = new_figure(5.6 + 0.1 * lines)
    heading(figure, "Ticks and states")
    if len(subjects) > 1:
        names_on(figure, [(subject.name, subject.colour) for subject in subjects])
    bands = 0.32 + 0.2 * len(subjects)
    rows = figure.add_gridspec(
        3, 1, height_ratios=(1.5, bands, 0.1 * lines), left=0.07, right=0.985, top=0.9, bottom=0.02, hspace=0.3
    )
    top = rows[0].subgridspec(1, 2, wspace=0.12, width_ratios=(1.0, 1.2))
    _histogram(figure.add_subplot(top[0]), subjects)
    _periods(figure.add_subplot(top[1]), subjects)
    axes = figure.add_subplot(rows[1])
    draw_bands(axes, subjects, numbered=True)
    axes.set_xlim(*_wide(span_of(subjects)))
    axes.set_xlabel(time_label(subjects))
    axes.set_title("Controller; the numbers are those of the reasons below")
    draw_numbers(axes, subjects)
    columns = rows[2].subgridspec(1, len(subjects), wspace=0.04)
    for index, subject in enumerate(subjects):
        words = figure.add_subplot(columns[index])
        if len(subjects) > 1:
            words.set_title(subject.name, color=subject.colour)
        write_reasons(words, subject, lines, LINE_CHARACTERS // len(subjects) - 2)
    return figure


def _wide(span: tuple[float, float]) -> tuple[float, float]:
    return span if span[1] > span[0] else (span[0], span[0] + 1.0)


def _histogram(axes: Any, subjects: Sequence[Subject]) -> None:
    """Times between ticks; the recordings hold no times spent."""
    axes.set_title("Time between ticks [ms]; dashed: median")
    periods = [1e3 * np.diff(subject.run.times_s) for subject in subjects]
    known = np.concatenate(periods)
    if not len(known):
        remark(axes, "fewer than two ticks")
        return
    low, high = float(known.min()), float(known.max())
    width = max((high - low) / BINS, LEAST_WIDTH_MS)
    edges = np.arange(low - 0.5 * width, high + 1.5 * width, width)
    for subject, values in zip(subjects, periods, strict=True):
        if not len(values):
            continue
        filled = {"histtype": "stepfilled", "alpha": 0.55} if len(subjects) == 1 else {"histtype": "step"}
        axes.hist(values, bins=edges, color=subject.colour, linewidth=1.2, **filled)
        axes.axvline(float(np.median(values)), color=subject.colour, linewidth=1.0, linestyle="--")
    axes.set_yscale("log")
    axes.set_ylabel("ticks")
    axes.annotate(
        "time spent in a tick: not recorded", (0.99, 0.95), xycoords="axes fraction", ha="right", va="top", color=GREY
    )


def _periods(axes: Any, subjects: Sequence[Subject]) -> None:
    axes.set_title("Time between ticks [ms] over the run")
    for subject in subjects:
        if len(subject.run.times_s) > 1:
            values = thin(subject.times_s[1:], 1e3 * np.diff(subject.run.times_s))
            axes.plot(*values, color=subject.colour, linewidth=0.8)
    axes.set_ylim(bottom=0.0)
    axes.set_xlim(*_wide(span_of(subjects)))
    axes.set_xlabel(time_label(subjects))

"""Plots of the components of a task that are not exact: bands shaded with the deviation inside, free parts in grey.

They are drawn apart from the errors, which count only what exceeds the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.math.task_tolerance import COMPONENTS
from ik_node.math.types import Array
from ik_node.report.reported_run import ReportedRun
from ik_node.report.run_tasks import TaskSeries
from ik_node.report.style import GREEN, GREY, TEXT_COLOUR, decimate
from ik_node.report.tracking import TrackingSeries

HEIGHT_IN = 0.36
"""Of one component, relative to the other plots."""
MARGIN = 1.25
"""Axes end at this multiple of the largest value."""
MIN_SPAN = 1e-3
"""Least end of the axes, mm or mrad: rounding errors are not enlarged."""


def loose_components(reported_runs: Sequence[ReportedRun]) -> list[int]:
    """Indices of the components that are a band or free in one of the runs; empty where whole poses are followed."""
    widths = [task.half_widths for _, _, task in _tasks(reported_runs)]
    return [index for index in range(6) if any((each[:, index] > 0.0).any() for each in widths)]


def draw_task_components(rows: Sequence[Any], reported_runs: Sequence[ReportedRun]) -> None:
    """Draws the components of :func:`loose_components`, one plot each.

    Args:
        rows: Axes of matplotlib, from top to bottom.
        reported_runs: One run, or several.
    """
    place: Any = {"xycoords": "axes fraction", "ha": "left", "va": "center", "annotation_clip": False}
    for axes, index in zip(rows, loose_components(reported_runs), strict=True):
        unit = "mm" if index < 3 else "mrad"
        span, strip = MIN_SPAN, 0.0
        texts: list[str] = []
        for reported, series, task in _tasks(reported_runs):
            times, widths = series.times_s - reported.zero_s, 1e3 * task.half_widths[:, index]
            values = np.where(series.inside, 1e3 * task.components[:, index], np.nan)
            free, band = np.isinf(widths), np.isfinite(widths) & (widths > 0.0)
            if band.any():
                if strip != widths[band].max():  # the strip of runs with the same band is drawn once
                    axes.fill_between(times, -widths, widths, where=band, color=GREEN, alpha=0.18, linewidth=0)
                strip = float(widths[band].max())
                axes.plot(*decimate(times, np.where(band, values, np.nan)), color=reported.colour, linewidth=1.0)
                border, reached = strip, _largest(values[band])
                texts.append(f"{_short(reached)} of \N{PLUS-MINUS SIGN}{_short(border)} {unit}")
                span = max(span, border, reached)
            if free.any():
                colour = GREY if len(reported_runs) == 1 else reported.colour
                drawn = _without_jumps(np.where(free, values, np.nan), index)
                axes.plot(*decimate(times, drawn), color=colour, linewidth=0.8, alpha=0.8)
                texts.append(f"free: {_short(_largest(values[free]))}\n{unit}")
                span = max(span, _largest(values[free]))
        axes.set_ylim(-MARGIN * span, MARGIN * span)
        axes.set_yticks([0.0])
        axes.set_yticklabels([COMPONENTS[index]], fontsize=8)
        if len(reported_runs) == 1:
            axes.annotate("\n".join(texts), (1.005, 0.5), fontsize=7.5, color=TEXT_COLOUR, **place)
    if rows:
        frames = sorted(
            {str(reported.run.settings.get("task.frame", "tool")) for reported, _, _ in _tasks(reported_runs)}
        )
        title = f"Within the tolerance ({' or '.join(frames)} axes): bands shaded"
        rows[0].set_title(f"{title}, free parts grey; right: maximum" if len(reported_runs) == 1 else title)


def _tasks(reported_runs: Sequence[ReportedRun]) -> list[tuple[ReportedRun, TrackingSeries, TaskSeries]]:
    known = [(reported, reported.metrics.series) for reported in reported_runs]
    return [(one, series, series.task) for one, series in known if series is not None and series.task is not None]


def _short(number: float) -> str:
    return f"{number:.0f}" if number >= 1000.0 else f"{number:.3g}"


def _largest(values: Array) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _without_jumps(values: Array, index: int) -> Array:
    """A rotation, mrad, with a gap where it passes half a turn."""
    if index < 3:
        return values
    found: Array = values.copy()
    with np.errstate(invalid="ignore"):
        found[1:][np.abs(np.diff(values)) > 1e3 * np.pi] = np.nan
    return found

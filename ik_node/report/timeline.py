"""The controller's states over time: as intervals, as coloured mode bars, and as a list of reasons."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.step import Level, Mode
from ik_node.math.types import Array
from ik_node.report.deviation import TRUNCATION
from ik_node.report.reported_run import ReportedRun
from ik_node.report.style import AMBER, MODE_COLOURS, RED, TEXT_COLOUR

MIN_NUMBER_GAP = 0.013
"""Space that a number on a mode bar needs, as a fraction of the axis."""
SLOWED, GIVEN_UP = "slowed", "direction given up"
DARK_TEXT = frozenset({Mode.WAITING, Mode.HOLDING, Mode.RAMPING, Mode.PAUSED})
"""Modes whose colour needs dark text."""


class StateInterval(NamedTuple):
    """Interval between two changes of the status."""

    number: int
    """From 1."""
    begin_s: float
    """On the plots' axis."""
    duration_s: float
    mode: Mode
    level: Level
    reason: str


def state_intervals(reported: ReportedRun) -> tuple[StateInterval, ...]:
    """All intervals in order."""
    begins = [change.time_s for change in reported.run.status_changes]
    if not begins:
        return ()
    ends = [*begins[1:], max(float(reported.run.times_s[-1]), begins[-1])]
    return tuple(
        StateInterval(
            index + 1,
            change.time_s - reported.zero_s,
            end - change.time_s,
            change.status.mode,
            change.status.level,
            change.status.reason,
        )
        for index, (change, end) in enumerate(zip(reported.run.status_changes, ends, strict=True))
    )


class ConditionSpans(NamedTuple):
    """(begin, duration), s, on the plots' axis."""

    slowed: list[tuple[float, float]]
    """s < 1."""
    given_up: list[tuple[float, float]]
    """A component of the twist is given up near a singularity."""


def condition_spans(reported: ReportedRun) -> ConditionSpans:
    """Where the arm was slowed, and where a direction was given up."""
    run = reported.run
    with np.errstate(invalid="ignore"):
        slowed = run.scale < 1.0
        given_up = np.abs(run.truncated_b).max(axis=1, initial=0.0) > TRUNCATION
    return ConditionSpans(_spans(reported.times_s, slowed), _spans(reported.times_s, given_up))


def _spans(times_s: Array, holds: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Begin and duration of the rows that hold; each row lasts until the next one."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], holds, [False])).astype(np.int8)))
    ends = [times_s[min(row, len(times_s) - 1)] for row in edges[1::2]]
    return [(float(times_s[row]), float(end - times_s[row])) for row, end in zip(edges[::2], ends, strict=True)]


def draw_mode_bars(axes: Any, reported_runs: Sequence[ReportedRun], numbered: bool = False) -> None:
    """Draws a mode bar per recording with a legend; ``numbered`` leaves room for :func:`draw_numbers`."""
    shown: list[Mode] = []
    conditions: dict[str, str] = {}
    for row, reported in enumerate(reported_runs):
        for interval in state_intervals(reported):
            shown += [interval.mode] if interval.mode not in shown else []
            axes.broken_barh(
                [(interval.begin_s, interval.duration_s)],
                (row - 0.4, 0.8),
                facecolors=MODE_COLOURS[interval.mode],
                linewidth=0,
            )
        marks = condition_spans(reported)
        for spans, colour in ((marks.slowed, AMBER), (marks.given_up, RED)):
            axes.broken_barh(spans, (row - 0.4, 0.8), facecolors=colour, linewidth=0)
        conditions |= {
            name: colour
            for name, spans, colour in ((SLOWED, marks.slowed, AMBER), (GIVEN_UP, marks.given_up, RED))
            if spans
        }
    axes.set_ylim(len(reported_runs) - 0.5, -0.85 if numbered else -0.5)
    axes.set_yticks(range(len(reported_runs)))
    axes.set_yticklabels([reported.name for reported in reported_runs] if len(reported_runs) > 1 else [""], fontsize=8)
    axes.tick_params(axis="y", length=0)
    for label, reported in zip(axes.get_yticklabels(), reported_runs, strict=True):
        label.set_color(reported.colour)
    axes.grid(visible=False)
    axes.set_title("Controller")
    _legend(axes, {mode.value: MODE_COLOURS[mode] for mode in shown} | conditions)


def draw_numbers(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Writes the interval numbers on the mode bars where there is room; call it after the axis limits are set."""
    low, high = axes.get_xlim()
    for row, reported in enumerate(reported_runs):
        last = -float("inf")
        for interval in state_intervals(reported):
            if min(interval.begin_s - last, high - interval.begin_s) < MIN_NUMBER_GAP * (high - low):
                continue
            last = interval.begin_s
            text_colour = TEXT_COLOUR if interval.mode in DARK_TEXT else "white"
            axes.plot([last, last], [row - 0.4, row + 0.4], color="white", linewidth=0.6)
            axes.annotate(
                str(interval.number),
                (last, row),
                xytext=(2.0, 0.0),
                textcoords="offset points",
                fontsize=6.5,
                color=text_colour,
                va="center",
                clip_on=True,
            )


def number_of_reason_lines(reported: ReportedRun, width: int) -> int:
    """Lines of :func:`write_reasons` without a limit of their number."""
    return sum(len(_reason_lines(interval, width)) for interval in state_intervals(reported))


def _reason_lines(interval: StateInterval, width: int) -> list[str]:
    text = f"{interval.number:>3} {interval.begin_s:8.2f} s  {interval.mode.value:<9} {interval.reason}"
    wrapped = textwrap.wrap(text, width, subsequent_indent=" " * 16, drop_whitespace=True) or [""]
    wrapped[0] = text[: len(text) - len(text.lstrip())] + wrapped[0].lstrip()
    return wrapped


def write_reasons(axes: Any, reported: ReportedRun, max_lines: int, width: int) -> None:
    """Lists the intervals of one recording as text, the first ones if there are too many."""
    axes.axis("off")
    lines: list[tuple[str, str]] = []
    intervals = state_intervals(reported)
    for interval in intervals:
        colour = TEXT_COLOUR if interval.level is Level.OK else "#8a3a00"
        wrapped = _reason_lines(interval, width)
        if len(lines) + len(wrapped) > max_lines - 1:
            lines.append(
                (f"... and {len(intervals) - interval.number + 1} more; the HTML report lists all", TEXT_COLOUR)
            )
            break
        lines += [(line, colour) for line in wrapped]
    for index, (line, colour) in enumerate(lines):
        axes.text(
            0.0,
            1.0 - index / max_lines,
            line,
            family="monospace",
            fontsize=7.0,
            va="top",
            color=colour,
            transform=axes.transAxes,
        )


def _legend(axes: Any, colours: Mapping[str, str]) -> None:
    from matplotlib.patches import Patch

    if colours:
        axes.legend(
            handles=[Patch(color=colour, label=name) for name, colour in colours.items()],
            loc="lower right",
            bbox_to_anchor=(1.0, 0.98),
            ncols=len(colours),
            frameon=False,
            fontsize=8,
        )

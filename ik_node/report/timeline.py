"""What the controller was doing, when and why: as rows, and as coloured bands with the reasons beneath."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

from ik_node.interfaces.step import Level, Mode
from ik_node.report.reported_run import Subject
from ik_node.report.style import INK, MODE_COLOURS

LEAST_GAP = 0.013
"""Part of the axis that a number above a band needs."""
DARK_TEXT = frozenset({Mode.WAITING, Mode.HOLDING, Mode.RAMPING, Mode.PAUSED})
"""Modes whose colour is read better with dark letters on it."""


class Entry(NamedTuple):
    """From one change of state to the next."""

    number: int
    """From 1."""
    begin_s: float
    """On the pictures' axis."""
    duration_s: float
    mode: Mode
    level: Level
    reason: str


def entries(subject: Subject) -> tuple[Entry, ...]:
    """Every state in turn."""
    moments = [change.time_s for change in subject.run.statuses]
    if not moments:
        return ()
    ends = [*moments[1:], max(float(subject.run.times_s[-1]), moments[-1])]
    return tuple(
        Entry(
            index + 1,
            change.time_s - subject.zero_s,
            end - change.time_s,
            change.status.mode,
            change.status.level,
            change.status.reason,
        )
        for index, (change, end) in enumerate(zip(subject.run.statuses, ends, strict=True))
    )


def draw_bands(axes: Any, subjects: Sequence[Subject], numbered: bool = False) -> None:
    """A band per recording, coloured by mode, with a legend of the modes; ``numbered``: as the reasons are."""
    used: list[Mode] = []
    for row, subject in enumerate(subjects):
        for entry in entries(subject):
            used += [entry.mode] if entry.mode not in used else []
            axes.broken_barh(
                [(entry.begin_s, entry.duration_s)], (row - 0.4, 0.8), facecolors=MODE_COLOURS[entry.mode], linewidth=0
            )
    axes.set_ylim(len(subjects) - 0.5, -0.85 if numbered else -0.5)
    axes.set_yticks(range(len(subjects)))
    axes.set_yticklabels([subject.name for subject in subjects] if len(subjects) > 1 else [""], fontsize=8)
    axes.tick_params(axis="y", length=0)
    for label, subject in zip(axes.get_yticklabels(), subjects, strict=True):
        label.set_color(subject.colour)
    axes.grid(visible=False)
    axes.set_title("Controller")
    _legend(axes, used)


def draw_numbers(axes: Any, subjects: Sequence[Subject]) -> None:
    """The numbers of the entries on their bands, as many as have room; after the limits of the axis are set."""
    low, high = axes.get_xlim()
    for row, subject in enumerate(subjects):
        last = -float("inf")
        for entry in entries(subject):
            if entry.begin_s - last < LEAST_GAP * (high - low):
                continue
            last = entry.begin_s
            ink = INK if entry.mode in DARK_TEXT else "white"
            axes.plot([last, last], [row - 0.4, row + 0.4], color="white", linewidth=0.6)
            axes.annotate(
                str(entry.number),
                (last, row),
                xytext=(2.0, 0.0),
                textcoords="offset points",
                fontsize=6.5,
                color=ink,
                va="center",
                clip_on=True,
            )


def write_reasons(axes: Any, subject: Subject, most_lines: int, width: int) -> None:
    """The entries of one recording as text, the first ones where there are too many."""
    axes.axis("off")
    lines: list[tuple[str, str]] = []
    every = entries(subject)
    for entry in every:
        words = f"{entry.number:>3} {entry.begin_s:8.2f} s  {entry.mode.value:<9} {entry.reason}"
        colour = INK if entry.level is Level.OK else "#8a3a00"
        wrapped = textwrap.wrap(words, width, subsequent_indent=" " * 16, drop_whitespace=True) or [""]
        wrapped[0] = words[: len(words) - len(words.lstrip())] + wrapped[0].lstrip()
        if len(lines) + len(wrapped) > most_lines - 1:
            lines.append((f"... and {len(every) - entry.number + 1} more, all of them in the HTML report", INK))
            break
        lines += [(line, colour) for line in wrapped]
    for index, (line, colour) in enumerate(lines):
        axes.text(
            0.0,
            1.0 - index / most_lines,
            line,
            family="monospace",
            fontsize=7.0,
            va="top",
            color=colour,
            transform=axes.transAxes,
        )


def _legend(axes: Any, modes: Sequence[Mode]) -> None:
    from matplotlib.patches import Patch

    if modes:
        axes.legend(
            handles=[Patch(color=MODE_COLOURS[mode], label=mode.value) for mode in modes],
            loc="lower right",
            bbox_to_anchor=(1.0, 0.98),
            ncols=len(modes),
            frameon=False,
            fontsize=8,
        )

"""Pictures of the frontier of ``ik_benchmark streams --frontier``: one of each stream, and one of all."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Any

from benchmarks.stream_frontier import EQUAL, HALVES, NODE, FrontierRow
from ik_node.report.canvas import convert_write_errors, new_figure, report_style
from ik_node.report.style import AMBER, BLUE, GREEN, GREY, LIGHT_GREY, PURPLE, RED, VERMILION

UNITS = (("mm", "m/s$^2$"), ("mrad", "rad/s$^2$"))
HEIGHT_IN = 6.4
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, AMBER, GREY, RED)
"""Of the families."""
ROW_IN = 0.22
"""Height of the line of a recording in the picture of all."""
LIMITS = (0.3, 40.0)
"""Range of the ratios in the picture of all; others are drawn at its ends."""


def draw_stream(rows: Sequence[FrontierRow], path: Path) -> None:
    """Write the picture of the rows of one stream: error and lag over acceleration, by position and orientation.

    Raises:
        RecordingError: The file cannot be written.
        MissingPackageError: matplotlib is not installed.
    """
    with report_style(), convert_write_errors():
        figure = new_figure(HEIGHT_IN)
        axes = figure.subplots(2, len(rows), squeeze=False, sharex="col")
        for column, row in enumerate(rows):
            _draw_curves(axes[0][column], axes[1][column], row)
        figure.suptitle(f"{rows[0].stream}, {rows[0].noise}")
        axes[0][0].legend(fontsize="x-small")
        figure.savefig(path)


def _draw_curves(errors: Any, lags: Any, row: FrontierRow) -> None:
    error_unit, acceleration_unit = UNITS[HALVES.index(row.half)]
    for axes, value, label in (
        (errors, "after_lag", f"error after lag, {error_unit}"),
        (lags, "lag_ms", "lag, ms"),
    ):
        for family in row.families:
            points = [rival for rival in row.rivals if rival.family == family]
            axes.plot(
                [p.acceleration for p in points],
                [getattr(p, value) for p in points],
                ".-",
                label=family,
                linewidth=0.8,
            )
        axes.plot([row.node.acceleration], [getattr(row.node, value)], "k*", markersize=11, label=NODE)
        axes.set_xscale("log")
        axes.tick_params(axis="x", which="minor", labelbottom=False)
        axes.set_ylabel(label)
    errors.set_yscale("log")
    errors.set_title(row.half)
    lags.set_xlabel(f"RMS acceleration over 20 ms, {acceleration_unit}")


def draw_all(rows: Sequence[FrontierRow], path: Path) -> None:
    """Write the picture of all rows: error and lag of the rival of least error at equal acceleration, and of the node.

    One mark per noise. The grey range is missed: the rival is closer by more than a tenth.

    Raises:
        RecordingError: The file cannot be written.
        MissingPackageError: matplotlib is not installed.
    """
    names = list(dict.fromkeys(row.stream for row in rows))
    families = list(dict.fromkeys(family for row in rows for family in row.families))
    colours = {family: COLOURS[i % len(COLOURS)] for i, family in enumerate(families)}
    with report_style(), convert_write_errors():
        figure = new_figure(1.2 + ROW_IN * len(names))
        figure.set_layout_engine("constrained")
        axes = figure.subplots(1, 2 * len(HALVES), sharey=True, gridspec_kw={"width_ratios": (3, 2) * len(HALVES)})
        for half, (errors, lags) in zip(HALVES, (axes[:2], axes[2:]), strict=True):
            _draw_half(errors, lags, [row for row in rows if row.half == half], names, colours)
        axes[0].set_yticks(range(len(names)), names)
        axes[0].set_ylim(len(names) - 0.5, -0.5)
        shown = [f for f in families if any(row.ratio[1] == f for row in rows)]
        marks = [axes[0].plot([], [], "o", color=colours[family], label=family)[0] for family in shown]
        marks.append(axes[0].plot([], [], "k*", label=NODE)[0])
        marks.append(axes[0].plot([], [], ">", color="k", fillstyle="none", label="no rival is as smooth")[0])
        figure.legend(handles=marks, loc="outside lower center", ncols=len(marks), fontsize="small")
        figure.savefig(path)


def _draw_half(
    errors: Any, lags: Any, rows: Sequence[FrontierRow], names: Sequence[str], colours: dict[str, str]
) -> None:
    errors.axvspan(0.5 * LIMITS[0], 1.0 / EQUAL, color=LIGHT_GREY, zorder=0)
    errors.axvline(1.0, color="k", linewidth=0.8)
    for row in rows:
        line = names.index(row.stream)
        error, family, lag_ms = row.best_rival
        lags.plot(row.node.lag_ms, line, "k*", markersize=6)
        if error == inf:
            errors.plot(LIMITS[1], line, ">", color="k", fillstyle="none", markersize=5)
            continue
        errors.plot(
            min(max(error / row.node.after_lag, LIMITS[0]), LIMITS[1]), line, "o", color=colours[family], markersize=4
        )
        lags.plot(lag_ms, line, "o", color=colours[family], markersize=4)
    errors.set_xscale("log")
    errors.set_xlim(0.95 * LIMITS[0], 1.15 * LIMITS[1])
    errors.set_xticks((0.5, 1, 2, 5, 10, 20, 40), ("0.5", "1", "2", "5", "10", "20", "40"))
    errors.tick_params(axis="x", which="minor", bottom=False, labelbottom=False)
    if rows:
        errors.set_title(rows[0].half)
    errors.set_xlabel(f"error after the lag, best rival / {NODE}")
    lags.set_xlabel("lag, ms")

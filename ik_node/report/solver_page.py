"""Inputs and results of the solver: singular values, scale, clearance, twist account, multipliers and energies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.report.canvas import new_figure
from ik_node.report.curves import (
    draw_clearance,
    draw_gravitational_energy,
    draw_kinetic_energy,
    draw_null_space_speed,
    draw_repulsion,
    draw_scale,
    draw_singular_values,
    draw_twist_account,
)
from ik_node.report.extremes import potential_wrench
from ik_node.report.quantities import UNWEIGHTED
from ik_node.report.reported_run import ReportedRun, methods_of, span_of, time_label
from ik_node.report.style import (
    BLUE,
    GREEN,
    GREY,
    VERMILION,
    decimate,
    page_heading,
    placeholder,
    placeholder_text,
    run_legend,
    share_time_axis,
)

AXIS_COLOURS = (VERMILION, GREEN, BLUE)
"""Of x, y and z."""
TOP_IN, ROW_IN, BOTTOM_IN, LINE_IN = 0.94, 1.98, 0.6, 0.2
"""Heights of the parts of the page, in: heading, a row of plots, the time axis, a line of text."""


def draw_solver(reported_runs: Sequence[ReportedRun]) -> Any:
    """Draws the page: components of the multiplier for one recording, norms for several.

    Quantities without values, or zero throughout, are lines of text at its end.
    """
    figure = new_figure(1.0)
    left, right = ([figure.add_subplot(6, 2, 2 * row + column) for row in range(6)] for column in (1, 2))
    draw_singular_values(left[0], reported_runs)
    draw_scale(left[1], reported_runs)
    draw_clearance(left[2], reported_runs)
    draw_twist_account(left[3], reported_runs)
    draw_kinetic_energy(left[4], reported_runs)
    draw_gravitational_energy(right[4], reported_runs)
    draw_null_space_speed(left[5], reported_runs)
    draw_repulsion(right[5], reported_runs)
    momenta = [reported.run.multiplier_task for reported in reported_runs]
    wrenches = [potential_wrench(reported.run) for reported in reported_runs]
    potential, frame = "λ potential / k", _frame(reported_runs)
    for axes, terms, components, label in (
        (right[0], momenta, slice(0, 3), f"λ task, linear {_unit(reported_runs, 'N s')}"),
        (right[1], momenta, slice(3, 6), f"λ task, angular {_unit(reported_runs, 'N m s')}"),
        (right[2], wrenches, slice(0, 3), f"{potential}: force [N]"),
        (right[3], wrenches, slice(3, 6), f"{potential}: torque [N m]"),
    ):
        _draw_vectors(axes, reported_runs, [term[:, components] for term in terms], label + frame)
    drawn = _arranged(figure, (left, right))
    page_heading(figure, "Solver")
    if len(reported_runs) > 1:
        run_legend(figure, [(reported.name, reported.colour) for reported in reported_runs])
    for column in drawn:
        share_time_axis(column, span_of(reported_runs), time_label(reported_runs))
    return figure


def _arranged(figure: Any, columns: tuple[list[Any], list[Any]]) -> tuple[list[Any], list[Any]]:
    """Sets the height of the page and places the axes that have data; writes the title of each other at the end."""
    drawn: tuple[list[Any], list[Any]] = ([], [])
    notes = []
    for column, kept in zip(columns, drawn, strict=True):
        for axes in column:
            text = placeholder_text(axes)
            if text:
                notes.append(f"{axes.get_title(loc='left')}: {text}")
                axes.remove()
            else:
                kept.append(axes)
    rows = max(map(len, drawn))
    end_in = BOTTOM_IN + LINE_IN * len(notes)
    height_in = TOP_IN + ROW_IN * rows + end_in
    figure.set_figheight(height_in)
    place = {"left": 0.05, "right": 0.985, "top": 1.0 - TOP_IN / height_in, "bottom": end_in / height_in}
    grid = figure.add_gridspec(rows, 2, **place, hspace=0.32, wspace=0.1)
    for index, kept in enumerate(drawn):
        for row, axes in enumerate(kept):
            axes.set_subplotspec(grid[row, index])
    for line, note in enumerate(notes):
        figure.text(0.05, (end_in - BOTTOM_IN - LINE_IN * line) / height_in, note, color=GREY, va="top", fontsize=9)
    return drawn


def _draw_vectors(axes: Any, reported_runs: Sequence[ReportedRun], vectors: Sequence[Array], label: str) -> None:
    """Components x, y, z of vectors (k, 3) of one recording, or their norms for several recordings."""
    if not any((np.abs(rows[np.isfinite(rows)]) > 0.0).any() for rows in vectors):
        axes.set_title(label)
        placeholder(axes, "zero: no active potential" if "potential" in label else "zero, or not computed")
        return
    if len(reported_runs) == 1:
        axes.set_title(label)
        for column, (name, colour) in enumerate(zip("xyz", AXIS_COLOURS, strict=True)):
            axes.plot(
                *decimate(reported_runs[0].times_s, vectors[0][:, column]), color=colour, linewidth=0.9, label=name
            )
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, frameon=False, fontsize=8)
        return
    axes.set_title(f"Norm of {label}")
    for reported, rows in zip(reported_runs, vectors, strict=True):
        axes.plot(*decimate(reported.times_s, np.linalg.norm(rows, axis=1)), color=reported.colour, linewidth=0.9)
    axes.set_ylim(bottom=0.0)


def _unit(reported_runs: Sequence[ReportedRun], unit: str) -> str:
    unweighted = [method in UNWEIGHTED for reported in reported_runs for method in methods_of(reported)]
    if all(unweighted):
        return "(not mass-weighted)"
    return f"[{unit}; {', '.join(UNWEIGHTED)}: none]" if any(unweighted) else f"[{unit}]"


def _frame(reported_runs: Sequence[ReportedRun]) -> str:
    frames = {str(reported.run.settings.get("jacobian", "body")) for reported in reported_runs}
    return f", in the {frames.pop()} frame" if len(frames) == 1 else ""

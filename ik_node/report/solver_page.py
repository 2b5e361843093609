"""What the law had to work with and what it made of it: singular values, s, clearance, and the multiplier's terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.report.canvas import new_figure
from ik_node.report.reported_run import Subject, methods_of, potential_wrench, span_of, time_label
from ik_node.report.style import BLUE, GREEN, GREY, INK, VERMILION, names_on, only_last_has_times, remark, thin

AXIS_COLOURS = (VERMILION, GREEN, BLUE)
"""Of x, y and z."""
UNWEIGHTED = "plain"
"""The method whose multiplier is no momentum: it weighs by no mass."""


def draw_law(subjects: Sequence[Subject]) -> Any:
    """The page; for one recording the multiplier by components, for several its norms."""
    figure = new_figure(9.2)
    figure.suptitle(
        "Singular values, scale, clearance and multiplier", x=0.03, ha="left", fontsize=13, fontweight="bold"
    )
    if len(subjects) > 1:
        names_on(figure, [(subject.name, subject.colour) for subject in subjects])
    grid = figure.add_gridspec(4, 2, left=0.05, right=0.985, top=0.9, bottom=0.06, hspace=0.32, wspace=0.1)
    left = [figure.add_subplot(grid[row, 0]) for row in range(4)]
    right = [figure.add_subplot(grid[row, 1]) for row in range(4)]
    draw_singular_values(left[0], subjects)
    draw_scale(left[1], subjects)
    draw_clearance(left[2], subjects)
    _lost(left[3], subjects)
    momenta = [subject.run.multiplier_task for subject in subjects]
    wrenches = [potential_wrench(subject) for subject in subjects]
    potential, frame = "λ potential times 1/k", _frame(subjects)
    for axes, terms, part, label in (
        (right[0], momenta, slice(0, 3), f"λ task, linear {_unit(subjects, 'N s')}"),
        (right[1], momenta, slice(3, 6), f"λ task, angular {_unit(subjects, 'N m s')}"),
        (right[2], wrenches, slice(0, 3), f"{potential}: force [N]"),
        (right[3], wrenches, slice(3, 6), f"{potential}: torque [N m]"),
    ):
        _vectors(axes, subjects, [term[:, part] for term in terms], label + frame)
    for column in (left, right):
        only_last_has_times(column, span_of(subjects), time_label(subjects))
    return figure


def draw_singular_values(axes: Any, subjects: Sequence[Subject]) -> None:
    """All of them, the least one thick, with the thresholds below which a direction is looked after."""
    thresholds = set()
    for subject in subjects:
        values = subject.run.singular_values
        for column in range(values.shape[1] - 1):
            if len(subjects) == 1:
                axes.plot(*thin(subject.times_s, values[:, column]), color=GREY, linewidth=0.7)
        axes.plot(*thin(subject.times_s, values[:, -1]), color=subject.colour, linewidth=1.4)
        threshold = subject.run.settings.get("singularity.threshold")
        if isinstance(threshold, float):
            thresholds.add(threshold)
    for threshold in sorted(thresholds):
        axes.axhline(threshold, color=INK, linewidth=0.9, linestyle="--")
    axes.set_ylim(bottom=0.0)
    which = "Singular values of J (the least in blue)" if len(subjects) == 1 else "Least singular value of J"
    axes.set_title(f"{which} [m]; looked after below the dashed line")


def draw_scale(axes: Any, subjects: Sequence[Subject]) -> None:
    """s over time."""
    for subject in subjects:
        axes.plot(*thin(subject.times_s, subject.run.scale), color=subject.colour)
    axes.set_ylim(-0.02, 1.08)
    axes.set_title("Scale s: the part of the twist that the limits let through")


def draw_clearance(axes: Any, subjects: Sequence[Subject]) -> None:
    """Distance of the closest pair."""
    axes.set_title("Clearance [mm]")
    lines = 0
    for subject in subjects:
        known = np.isfinite(subject.run.clearance)
        if known.any():
            axes.plot(*thin(subject.times_s[known], 1e3 * subject.run.clearance[known]), color=subject.colour)
            lines += 1
    if not lines:
        remark(axes, "not measured")
        return
    axes.axhline(0.0, color=INK, linewidth=0.9, linestyle="--")
    if len(subjects) == 1:
        axes.set_title(f"Clearance [mm]; least between {' and '.join(subjects[0].report.nearness.pair)}")


def _lost(axes: Any, subjects: Sequence[Subject]) -> None:
    axes.set_title("Speed of the tool given up at singularities, |V - V_f| linear [mm/s]")
    norms = [1e3 * np.linalg.norm(subject.run.lost_b[:, :3], axis=1) for subject in subjects]
    if not any((norm[np.isfinite(norm)] > 1e-6).any() for norm in norms):
        remark(axes, "nothing was given up")
        return
    for subject, norm in zip(subjects, norms, strict=True):
        axes.plot(*thin(subject.times_s, norm), color=subject.colour)
    axes.set_ylim(bottom=0.0)


def _vectors(axes: Any, subjects: Sequence[Subject], vectors: Sequence[Array], label: str) -> None:
    """Components x, y, z of one recording's vectors (k, 3), or the norms of several recordings'."""
    if not any((np.abs(rows[np.isfinite(rows)]) > 0.0).any() for rows in vectors):
        axes.set_title(label)
        remark(
            axes, "zero: no such term, or nothing within its range" if "potential" in label else "zero, or not computed"
        )
        return
    if len(subjects) == 1:
        axes.set_title(label)
        for column, (name, colour) in enumerate(zip("xyz", AXIS_COLOURS, strict=True)):
            axes.plot(*thin(subjects[0].times_s, vectors[0][:, column]), color=colour, linewidth=0.9, label=name)
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), ncols=3, frameon=False, fontsize=8)
        return
    axes.set_title(f"Norm of {label}")
    for subject, rows in zip(subjects, vectors, strict=True):
        axes.plot(*thin(subject.times_s, np.linalg.norm(rows, axis=1)), color=subject.colour, linewidth=0.9)
    axes.set_ylim(bottom=0.0)


def _unit(subjects: Sequence[Subject], unit: str) -> str:
    plain = [method == UNWEIGHTED for subject in subjects for method in methods_of(subject)]
    if all(plain):
        return "(unweighted: no momentum)"
    return f"[{unit}; {UNWEIGHTED}: unweighted]" if any(plain) else f"[{unit}]"


def _frame(subjects: Sequence[Subject]) -> str:
    frames = {str(subject.run.settings.get("jacobian", "body")) for subject in subjects}
    return f", in the {frames.pop()} frame" if len(frames) == 1 else ""

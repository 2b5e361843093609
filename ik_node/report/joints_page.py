"""Joint positions and velocity commands between their limits, a strip per joint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.report.canvas import new_figure
from ik_node.report.metrics import part_of_limit
from ik_node.report.reported_run import Subject, all_joints, span_of, time_label
from ik_node.report.style import GREY, VERMILION, heading, names_on, only_last_has_times, thin

STRIP_IN = 1.05
EDGE = 0.06
"""Part of the range of a joint that is drawn beyond its limits."""
BEYOND = 118.0
"""End of the strips of velocities, % of the limit."""


def draw_joints(subjects: Sequence[Subject]) -> Any:
    """The page; positions at the left, velocity commands at the right. Limits are those at the run's start."""
    joints = all_joints(subjects)
    height = 1.3 + STRIP_IN * len(joints)
    figure = new_figure(height)
    heading(figure, "Joints")
    if len(subjects) > 1:
        names_on(figure, [(subject.name, subject.colour) for subject in subjects])
    grid = figure.add_gridspec(
        len(joints), 2, left=0.09, right=0.955, top=1.0 - 0.8 / height, bottom=0.5 / height, hspace=0.16, wspace=0.1
    )
    columns: list[list[Any]] = [[], []]
    for row, joint in enumerate(joints):
        for index, draw in enumerate((_position, _velocity)):
            axes = figure.add_subplot(grid[row, index])
            columns[index].append(axes)
            draw(axes, joint, [subject for subject in subjects if joint in subject.run.joints])
        columns[0][-1].set_ylabel(joint, rotation=0, ha="right", va="center", fontsize=8)
    columns[0][0].set_title("Measured position [rad, m], limits shaded; right: nearest a limit")
    columns[1][0].set_title("Velocity command [% of the limit]; right: peak")
    for column in columns:
        only_last_has_times(column, span_of(subjects), time_label(subjects))
    return figure


def _position(axes: Any, joint: str, subjects: Sequence[Subject]) -> None:
    lower, upper = np.inf, -np.inf
    near = []
    for subject in subjects:
        run, index = subject.run, subject.run.joints.index(joint)
        q, low, high = run.q[:, index], float(run.lower[index]), float(run.upper[index])
        axes.plot(*thin(subject.times_s, q), color=subject.colour, linewidth=0.9)
        lower, upper = min(lower, low), max(upper, high)
        near.append((_nearest(q, low, high), subject.colour))
    span = upper - lower
    if np.isfinite(span) and span > 0.0:
        axes.set_ylim(lower - EDGE * span, upper + EDGE * span)
        axes.axhspan(upper, upper + span, color=VERMILION, alpha=0.25, linewidth=0)
        axes.axhspan(lower - span, lower, color=VERMILION, alpha=0.25, linewidth=0)
        for subject in subjects:  # of one whose limits are narrower than another's
            for limit in (subject.run.lower, subject.run.upper):
                value = float(limit[subject.run.joints.index(joint)])
                if lower < value < upper:
                    axes.axhline(value, color=subject.colour, linewidth=0.8, linestyle="--")
    axes.locator_params(axis="y", nbins=3)
    axes.tick_params(axis="y", labelsize=7)
    _at_the_right(axes, [("no limit" if not np.isfinite(least) else f"{least:.2f}", colour) for least, colour in near])


def _velocity(axes: Any, joint: str, subjects: Sequence[Subject]) -> None:
    peaks = []
    for sign in (-1.0, 1.0):
        axes.axhspan(sign * 100.0, sign * 130.0, color=VERMILION, alpha=0.25, linewidth=0)
    for subject in subjects:
        percent = 100.0 * part_of_limit(subject.run)[:, subject.run.joints.index(joint)]
        axes.plot(*thin(subject.times_s, percent), color=subject.colour, linewidth=0.9)
        known = np.abs(percent[np.isfinite(percent)])
        limited = np.isfinite(subject.run.velocity_limits[subject.run.joints.index(joint)])
        peak = f"{known.max():.0f} %" if len(known) and limited else "no limit" if len(known) else "none"
        peaks.append((peak, subject.colour))
    axes.set_ylim(-BEYOND, BEYOND)
    axes.set_yticks([-100.0, 0.0, 100.0])
    axes.tick_params(axis="y", labelsize=7)
    _at_the_right(axes, peaks)


def _nearest(q: Array, lower: float, upper: float) -> float:
    """Least distance to a limit; negative beyond it, infinite without one."""
    known = q[np.isfinite(q)]
    return float(min((known - lower).min(), (upper - known).min())) if len(known) else float("nan")


def _at_the_right(axes: Any, texts: Sequence[tuple[str, str]]) -> None:
    """One figure below the other, each in the colour of its recording."""
    for index, (text, colour) in enumerate(texts):
        height = 0.5 + 0.22 * (0.5 * (len(texts) - 1) - index)
        axes.annotate(
            text,
            (1.006, height),
            xycoords="axes fraction",
            ha="left",
            va="center",
            fontsize=7,
            color=colour if len(texts) > 1 else GREY,
        )

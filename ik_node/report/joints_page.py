"""Positions and velocity commands of all joints with their limits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.report.canvas import new_figure
from ik_node.report.curves import draw_joint_velocity
from ik_node.report.reported_run import ReportedRun, all_joints, span_of, time_label
from ik_node.report.style import GREY, VERMILION, decimate, page_heading, run_legend, share_time_axis

ROW_IN = 1.05
NAME_POINTS = -34.0
"""Place of the name of a joint, left of the tick labels."""
LIMIT_MARGIN = 0.06
"""Fraction of a joint's range that is drawn beyond its limits."""


def draw_joints(reported_runs: Sequence[ReportedRun]) -> Any:
    """Draws the page: positions left, velocity commands right. The limits are those at the start of the run."""
    joints = all_joints(reported_runs)
    height = 1.3 + ROW_IN * len(joints)
    figure = new_figure(height)
    page_heading(figure, "Joints")
    if len(reported_runs) > 1:
        run_legend(figure, [(reported.name, reported.colour) for reported in reported_runs])
    grid = figure.add_gridspec(
        len(joints), 2, left=0.11, right=0.955, top=1.0 - 0.8 / height, bottom=0.5 / height, hspace=0.16, wspace=0.1
    )
    columns: list[list[Any]] = [[], []]
    for row, joint in enumerate(joints):
        for index, draw in enumerate((_draw_position, _draw_velocity)):
            axes = figure.add_subplot(grid[row, index])
            columns[index].append(axes)
            draw(axes, joint, [reported for reported in reported_runs if joint in reported.run.joints])
        place: Any = {"textcoords": "offset points", "ha": "right", "va": "center"}
        columns[0][-1].annotate(joint, (0.0, 0.5), (NAME_POINTS, 0.0), "axes fraction", fontsize=8, **place)
    columns[0][0].set_title("Measured position [rad, m]; right: smallest distance to a limit")
    columns[1][0].set_title("Velocity command [% of the limit]; right: peak")
    for column in columns:
        share_time_axis(column, span_of(reported_runs), time_label(reported_runs))
    return figure


def _draw_position(axes: Any, joint: str, reported_runs: Sequence[ReportedRun]) -> None:
    lower, upper = np.inf, -np.inf
    distances = []
    for reported in reported_runs:
        run, index = reported.run, reported.run.joints.index(joint)
        q, low, high = run.q[:, index], float(run.lower[index]), float(run.upper[index])
        axes.plot(*decimate(reported.times_s, q), color=reported.colour, linewidth=0.9)
        lower, upper = min(lower, low), max(upper, high)
        distances.append(_limit_distance(q, low, high))
    span = upper - lower
    if np.isfinite(span) and span > 0.0:
        axes.set_ylim(lower - LIMIT_MARGIN * span, upper + LIMIT_MARGIN * span)
        axes.axhspan(upper, upper + span, color=VERMILION, alpha=0.25, linewidth=0)
        axes.axhspan(lower - span, lower, color=VERMILION, alpha=0.25, linewidth=0)
        for reported in reported_runs:  # limits that are narrower than those of another recording
            for limit in (reported.run.lower, reported.run.upper):
                value = float(limit[reported.run.joints.index(joint)])
                if lower < value < upper:
                    axes.axhline(value, color=reported.colour, linewidth=0.8, linestyle="--")
    axes.locator_params(axis="y", nbins=3)
    axes.tick_params(axis="y", labelsize=7)
    texts = [f"{distance:.2f}" if np.isfinite(distance) else "no limit" for distance in distances]
    _annotate_right(axes, texts, reported_runs)


def _draw_velocity(axes: Any, joint: str, reported_runs: Sequence[ReportedRun]) -> None:
    peaks = draw_joint_velocity(axes, reported_runs, joint)
    axes.set_yticks([-100.0, 0.0, 100.0])
    axes.tick_params(axis="y", labelsize=7)
    _annotate_right(axes, peaks, reported_runs)


def _limit_distance(q: Array, lower: float, upper: float) -> float:
    """Smallest distance to a limit; negative beyond it, infinite without one."""
    finite = q[np.isfinite(q)]
    return float(min((finite - lower).min(), (upper - finite).min())) if len(finite) else float("nan")


def _annotate_right(axes: Any, texts: Sequence[str], reported_runs: Sequence[ReportedRun]) -> None:
    """Writes a text per recording to the right of the axes, in the colours of the recordings."""
    place: Any = {"xycoords": "axes fraction", "ha": "left", "va": "center"}
    for index, (text, reported) in enumerate(zip(texts, reported_runs, strict=True)):
        height = 0.5 + 0.22 * (0.5 * (len(texts) - 1) - index)
        colour = reported.colour if len(texts) > 1 else GREY
        axes.annotate(text, (1.006, height), fontsize=7, color=colour, **place)

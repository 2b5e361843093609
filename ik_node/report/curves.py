"""Plots of one quantity over time, for one recording or several, shared by the pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.interfaces.step import smallest_singular_value
from ik_node.interfaces.twist_account import TwistAccount, twist_account
from ik_node.math.types import Array
from ik_node.report import quantities
from ik_node.report.metrics import velocity_ratio
from ik_node.report.quantities import DisplayedQuantity
from ik_node.report.reported_run import ReportedRun
from ik_node.report.style import (
    BLUE,
    GREEN,
    GREY,
    PURPLE,
    TEXT_COLOUR,
    VERMILION,
    decimate,
    legend_above,
    placeholder,
)

VELOCITY_AXIS_END = 118.0
"""End of the axis of joint velocities, % of the limit."""
NULL_SPACE_AXIS_END = 0.01
"""Least end of the axis of the null-space speed, rad/s: rounding errors are not enlarged."""
NULL_SPEED = 1e-9
"""Null-space speed, rad/s, that counts as none: that of an arm whose joints the task determines."""


def draw_tracking_error(axes: Any, reported_runs: Sequence[ReportedRun], quantity: DisplayedQuantity) -> None:
    """Position or orientation error; for one recording with its settled RMS."""
    field = "position" if quantity is quantities.POSITION_ERROR else "orientation"
    known = [(reported, reported.metrics.series) for reported in reported_runs]
    lines = [(reported, series) for reported, series in known if series is not None]
    if not lines:
        axes.set_title(quantity.title)
        placeholder(axes, "not evaluated: no ground truth file and no recorded targets")
        return
    alone = len(reported_runs) == 1
    axes.set_title(f"{field.capitalize()} error [{quantity.unit}]" if alone else quantity.title)
    for reported, series in lines:
        curves = [(quantities.TOOL_TO_TRAJECTORY, series.tool_to_trajectory, reported.colour)]
        if alone:
            curves.append((quantities.REFERENCE_TO_TRAJECTORY, series.reference_to_trajectory, GREEN))
            curves.append((quantities.TOOL_TO_REFERENCE, series.tool_to_reference, PURPLE))
        for label, errors, colour in curves:
            shown = np.where(series.inside, quantity.scaled(getattr(errors, field)), np.nan)
            times, values = decimate(series.times_s - reported.zero_s, shown)
            if alone and errors is series.tool_to_trajectory:
                axes.fill_between(times, values, color=colour, alpha=0.18, linewidth=0)
            axes.plot(times, values, color=colour, label=label, linewidth=1.1 if colour == reported.colour else 0.9)
    axes.set_ylim(bottom=0.0)
    tracking = lines[0][0].metrics.tracking
    if alone and tracking is not None:
        rms = getattr(tracking.settled, f"{field}_rms_{quantity.unit}")
        legend_above(axes)
        if np.isfinite(rms):
            axes.axhline(rms, color=TEXT_COLOUR, linewidth=0.8, linestyle="--")
            place = {"xycoords": ("axes fraction", "data"), "ha": "left", "va": "center"}
            axes.annotate(
                f"RMS\n{rms:.3g}", (1.005, rms), color=TEXT_COLOUR, fontsize=8, annotation_clip=False, **place
            )


def draw_singular_values(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """The smallest singular value; for one recording the others too. Dashed: ``singularity.threshold``."""
    thresholds = set()
    for reported in reported_runs:
        values = reported.run.singular_values
        if len(reported_runs) == 1:
            for column in range(values.shape[1] - 1):
                axes.plot(*decimate(reported.times_s, values[:, column]), color=GREY, linewidth=0.7)
        axes.plot(*decimate(reported.times_s, smallest_singular_value(values)), color=reported.colour, linewidth=1.4)
        threshold = reported.run.settings.get("singularity.threshold")
        if isinstance(threshold, float):
            thresholds.add(threshold)
    for threshold in sorted(thresholds):
        axes.axhline(threshold, color=TEXT_COLOUR, linewidth=0.9, linestyle="--")
    axes.set_ylim(bottom=0.0)
    unit = quantities.SMALLEST_SINGULAR_VALUE.unit
    which = "Singular values of J (smallest in blue)" if len(reported_runs) == 1 else "Smallest singular value of J"
    axes.set_title(f"{which} [{unit}]; regulated below the dashed line")


def draw_scale(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """The task scale s."""
    for reported in reported_runs:
        axes.plot(*decimate(reported.times_s, reported.run.scale), color=reported.colour)
    axes.set_ylim(-0.02, 1.08)
    axes.set_title("Task scale s: ratio of the commanded to the desired twist")


def draw_clearance(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Distance to obstacles and between links for one recording, else that of the closest pair."""
    quantity = quantities.CLEARANCE
    axes.set_title(quantity.title)
    if len(reported_runs) == 1 and _draw_both_clearances(axes, reported_runs[0]):
        return
    lines = 0
    for reported in reported_runs:
        finite = np.isfinite(reported.run.clearance)
        if finite.any():
            values = quantity.scaled(reported.run.clearance[finite])
            axes.plot(*decimate(reported.times_s[finite], values), color=reported.colour)
            lines += 1
    if not lines:
        placeholder(axes, "not computed")
        return
    axes.axhline(0.0, color=TEXT_COLOUR, linewidth=0.9, linestyle="--")


def _draw_both_clearances(axes: Any, reported: ReportedRun) -> bool:
    """Draws both distances; False when they were not computed."""
    series, metrics = reported.metrics.clearance_series, reported.metrics
    if series is None:
        return False
    drawn = False
    for values, least, kind, colour in (
        (series.obstacle, metrics.obstacle_clearance, "to obstacles", VERMILION),
        (series.own, metrics.self_clearance, "between links", reported.colour),
    ):
        if np.isfinite(values).any():
            label = f"{kind}, min {quantities.CLEARANCE.text(least.least)}"
            axes.plot(series.times_s - reported.zero_s, quantities.CLEARANCE.scaled(values), color=colour, label=label)
            drawn = True
    if drawn:
        axes.axhline(0.0, color=TEXT_COLOUR, linewidth=0.9, linestyle="--")
        axes.set_title("Clearance [mm]")
        legend_above(axes, 2)
    return drawn


def draw_twist_account(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Linear speed of the parts of V that the tool does not do; for several recordings that of V - J qd."""
    unit = quantities.OFF_DIRECTION_LINEAR.unit
    accounts = [_account(reported) for reported in reported_runs]
    if len(reported_runs) == 1:
        axes.set_title(f"Twist not done, linear [{unit}]")
        parts = [
            ("held back along V", accounts[0].held_back, GREY),
            ("truncated", accounts[0].truncated, BLUE),
            ("off the direction", accounts[0].off_direction, VERMILION),
        ]
        curves = [(reported_runs[0], part, colour, label) for label, part, colour in parts]
    else:
        axes.set_title(f"Twist not done, |V - J qd|, linear [{unit}]")
        pairs = zip(reported_runs, accounts, strict=True)
        curves = [(reported, account.missing, reported.colour, "") for reported, account in pairs]
    norms = [quantities.OFF_DIRECTION_LINEAR.scaled(np.linalg.norm(part[:, :3], axis=1)) for _, part, _, _ in curves]
    if not any((norm[np.isfinite(norm)] > 1e-6).any() for norm in norms):
        placeholder(axes, "none")
        return
    for (reported, _, colour, label), norm in zip(curves, norms, strict=True):
        axes.plot(*decimate(reported.times_s, norm), color=colour, linewidth=0.9, label=label)
    if len(reported_runs) == 1:
        legend_above(axes)
    axes.set_ylim(bottom=0.0)


def draw_kinetic_energy(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Kinetic energy of the commands."""
    axes.set_title(quantities.KINETIC_ENERGY.title)
    for reported in reported_runs:
        series = reported.metrics.energy_series
        axes.plot(*decimate(series.times_s - reported.zero_s, series.kinetic), color=reported.colour)
    axes.set_ylim(bottom=0.0)


def draw_gravitational_energy(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """The gravitational energy minus its value at the start: the potential of ``gravity_gradient``."""
    axes.set_title(f"Gravitational energy - that at the start [{quantities.GRAVITATIONAL_ENERGY.unit}]")
    for reported in reported_runs:
        series = reported.metrics.energy_series
        known = np.isfinite(series.gravitational)
        if known.any():
            values = series.gravitational - series.gravitational[known][0]
            axes.plot(*decimate(series.times_s - reported.zero_s, values), color=reported.colour)


def draw_repulsion(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """The repulsive potential of near pairs: that of ``obstacle_gradient``."""
    axes.set_title(quantities.REPULSION.title)
    known = [reported for reported in reported_runs if (reported.metrics.energy_series.repulsion > 0.0).any()]
    if not known:
        placeholder(axes, "zero: no pair is near, or not computed")
        return
    for reported in known:
        series = reported.metrics.energy_series
        axes.plot(series.repulsion_times_s - reported.zero_s, series.repulsion, color=reported.colour)
    axes.set_ylim(bottom=0.0)


def draw_null_space_speed(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Norm of N qd: the joint velocity that moves no followed component of the tool."""
    axes.set_title(f"{quantities.NULL_SPACE_SPEED.title}: joint velocity that does not move the tool")
    if not any((reported.metrics.null_space_series.speed > NULL_SPEED).any() for reported in reported_runs):
        placeholder(axes, "none")
        return
    for reported in reported_runs:
        series = reported.metrics.null_space_series
        axes.plot(*decimate(series.times_s - reported.zero_s, series.speed), color=reported.colour)
    axes.set_ylim(bottom=0.0, top=max(axes.get_ylim()[1], NULL_SPACE_AXIS_END))


def _account(reported: ReportedRun) -> TwistAccount:
    run = reported.run
    return twist_account(run.twist_b, run.truncated_b, run.off_direction_b, run.scale)


def draw_joint_velocity(axes: Any, reported_runs: Sequence[ReportedRun], joint: str, fill: bool = False) -> list[str]:
    """Velocity command of a joint in % of its limit; the range beyond the limit is shaded.

    Returns:
        The peak of every recording as text.
    """
    peaks = []
    for sign in (-1.0, 1.0):
        axes.axhspan(sign * 100.0, sign * 130.0, color=VERMILION, alpha=0.25, linewidth=0)
    for reported in reported_runs:
        index = reported.run.joints.index(joint)
        percent = quantities.JOINT_SPEED.scaled(velocity_ratio(reported.run)[:, index])
        times, values = decimate(reported.times_s, percent)
        if fill:
            axes.fill_between(times, values, color=reported.colour, alpha=0.3, linewidth=0)
        axes.plot(times, values, color=reported.colour, linewidth=0.9)
        peaks.append(_peak(percent, bool(np.isfinite(reported.run.velocity_limits[index]))))
    axes.set_ylim(-VELOCITY_AXIS_END, VELOCITY_AXIS_END)
    return peaks


def _peak(percent: Array, limited: bool) -> str:
    finite = np.abs(percent[np.isfinite(percent)])
    if not len(finite):
        return "none"
    return f"{finite.max():.0f} %" if limited else "no limit"

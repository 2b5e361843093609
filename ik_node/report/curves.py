"""Plots of one quantity over time, for one recording or several, shared by the pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ik_node.interfaces.twist_account import TwistAccount, twist_account
from ik_node.math.types import Array
from ik_node.report import quantities
from ik_node.report.metrics import velocity_ratio
from ik_node.report.quantities import DisplayedQuantity
from ik_node.report.reported_run import ReportedRun
from ik_node.report.style import BLUE, GREY, TEXT_COLOUR, VERMILION, decimate, placeholder

VELOCITY_AXIS_END = 118.0
"""End of the axis of joint velocities, % of the limit."""


def draw_tracking_error(axes: Any, reported_runs: Sequence[ReportedRun], quantity: DisplayedQuantity) -> None:
    """Position or orientation error; for one recording with its settled RMS."""
    axes.set_title(quantity.title)
    field = quantity.name.replace(" ", "_")
    known = [(reported, reported.metrics.series) for reported in reported_runs]
    lines = [(reported, series) for reported, series in known if series is not None]
    if not lines:
        placeholder(axes, "not evaluated: no ground truth file and no recorded targets")
        return
    for reported, series in lines:
        errors = np.where(series.inside, quantity.scaled(getattr(series, field)), np.nan)
        times, values = decimate(series.times_s - reported.zero_s, errors)
        if len(reported_runs) == 1:
            axes.fill_between(times, values, color=reported.colour, alpha=0.18, linewidth=0)
        axes.plot(times, values, color=reported.colour)
    axes.set_ylim(bottom=0.0)
    tracking = lines[0][0].metrics.tracking
    if len(reported_runs) == 1 and tracking is not None:
        rms = getattr(tracking.settled, f"{field.removesuffix('_error')}_rms_{quantity.unit}")
        if np.isfinite(rms):
            axes.axhline(rms, color=VERMILION, linewidth=1.0, linestyle="--")
            place = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
            axes.annotate(f"RMS {rms:.3g}", (1.0, rms), color=VERMILION, **place)


def draw_singular_values(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """The smallest singular value; for one recording the others too. Dashed: ``singularity.threshold``."""
    thresholds = set()
    for reported in reported_runs:
        values = reported.run.singular_values
        if len(reported_runs) == 1:
            for column in range(values.shape[1] - 1):
                axes.plot(*decimate(reported.times_s, values[:, column]), color=GREY, linewidth=0.7)
        axes.plot(*decimate(reported.times_s, values[:, -1]), color=reported.colour, linewidth=1.4)
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
    """Distance of the closest pair."""
    quantity = quantities.CLEARANCE
    axes.set_title(quantity.title)
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
    if len(reported_runs) == 1:
        axes.set_title(f"{quantity.title}; minimum between {' and '.join(reported_runs[0].metrics.nearness.pair)}")


def draw_twist_account(axes: Any, reported_runs: Sequence[ReportedRun]) -> None:
    """Linear speed of the parts of V that the tool does not do; for several recordings that of V - J qd."""
    unit = quantities.OFF_DIRECTION_LINEAR.unit
    accounts = [_account(reported) for reported in reported_runs]
    if len(reported_runs) == 1:
        axes.set_title(f"Parts of the twist that are not done, linear [{unit}]")
        parts = [
            ("held back along V", accounts[0].held_back, GREY),
            ("truncated", accounts[0].truncated, BLUE),
            ("off the direction", accounts[0].off_direction, VERMILION),
        ]
        curves = [(reported_runs[0], part, colour, label) for label, part, colour in parts]
    else:
        axes.set_title(f"Part of the twist that is not done, |V - J qd| linear [{unit}]")
        pairs = zip(reported_runs, accounts, strict=True)
        curves = [(reported, account.missing, reported.colour, "") for reported, account in pairs]
    norms = [quantities.OFF_DIRECTION_LINEAR.scaled(np.linalg.norm(part[:, :3], axis=1)) for _, part, _, _ in curves]
    if not any((norm[np.isfinite(norm)] > 1e-6).any() for norm in norms):
        placeholder(axes, "none")
        return
    for (reported, _, colour, label), norm in zip(curves, norms, strict=True):
        axes.plot(*decimate(reported.times_s, norm), color=colour, linewidth=0.9, label=label)
    if len(reported_runs) == 1:
        axes.legend(loc="upper right", ncols=3, frameon=False, fontsize=8)
    axes.set_ylim(bottom=0.0)


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

"""The figures of a run."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.extremes import Margin, Multiplier, margin, multiplier
from ik_node.report.ground_truth import Truth, truth_from_targets
from ik_node.report.tracking import Series, Tracking, compare

SETTLE_S = 1.0
"""Errors in this time after the start are told apart."""
LOST_NOISE = 1e-9
"""A lost twist (m/s, rad/s) below this is rounding."""


class Ticks(NamedTuple):
    """When the controller ran."""

    number: int
    rate_hz: float
    """Mean over the run."""
    period_median_ms: float
    period_std_ms: float
    period_p99_ms: float
    period_max_ms: float
    missing: int
    """Ticks that were made and are not in the recording."""


class Speed(NamedTuple):
    """The fastest command."""

    part_of_limit: float
    joint: str
    time_s: float
    non_finite: int
    """Commands that were not finite."""
    over_limit: int
    """Commands above a velocity limit."""


class Singularity(NamedTuple):
    """What came near a singularity, and what it cost."""

    least: float
    """Least singular value of J_b with weighted angular rows, m."""
    time_s: float
    lost_linear_rms: float
    """Of V - V_f, m/s."""
    lost_linear_max: float
    lost_angular_rms: float
    """rad/s."""
    lost_angular_max: float
    lossy_s: float
    """Time in which something was lost, s."""


class Scaling(NamedTuple):
    """What the limits slowed down."""

    least: float
    """Least s."""
    slowed_s: float
    """Time with s < 1, s."""
    binding: tuple[tuple[str, float], ...]
    """Limits that bound, with the time they did in s, longest first."""


class Nearness(NamedTuple):
    """How near the arm came to obstacles and to itself."""

    least: float
    """Smallest clearance, m; NaN where none was measured."""
    time_s: float
    pair: tuple[str, ...]
    """Which two it was between."""


class Period(NamedTuple):
    """Time in one mode for one reason."""

    mode: str
    reason: str
    duration_s: float


class Report(NamedTuple):
    """Everything measured of one run."""

    robot: str
    trajectory: str
    method: str
    joints: tuple[str, ...]
    duration_s: float
    """From the first tick to the last."""
    tracking: Tracking | None
    """None when there is nothing to compare with."""
    ticks: Ticks
    speed: Speed
    singularity: Singularity
    scaling: Scaling
    nearness: Nearness
    margin: Margin
    multiplier: Multiplier
    periods: tuple[Period, ...]
    """Longest first."""
    targets: int
    """Poses received."""
    target_rate_hz: float
    dropped: int
    """Messages that the recording had to leave out."""
    complete: bool
    """Whether the recording was closed by its writer."""
    series: Series | None
    """For pictures; no part of the JSON."""


def figures(run: Run, truth: Truth | None = None, trajectory: str = "", settle_s: float = SETTLE_S) -> Report:
    """Measures ``run`` against ``truth``, else against the poses that were streamed to it.

    The error is that of the measured tool pose, which is the forward kinematics of the measured joint positions at the
    joint state's own stamp, against the truth at that same moment. The node's own desired pose has no part in it.
    """
    against = truth or truth_from_targets(run.targets, run.base_frame)
    tracking, series = (None, None) if against is None else compare(run, against, settle_s)
    held_s = _durations(run)
    return Report(
        robot=run.robot or robot_name(run.urdf),
        trajectory=trajectory,
        method=str(run.settings.get("method", "")),
        joints=run.joints,
        duration_s=float(run.times_s[-1] - run.times_s[0]) if len(run.times_s) else 0.0,
        tracking=tracking,
        ticks=_ticks(run),
        speed=_speed(run),
        singularity=_singularity(run, held_s),
        scaling=_scaling(run, held_s),
        nearness=_nearness(run),
        margin=margin(run),
        multiplier=multiplier(run),
        periods=_periods(run, held_s),
        targets=len(run.targets.times_s),
        target_rate_hz=_rate(run.targets.times_s),
        dropped=run.dropped,
        complete=run.complete,
        series=series,
    )


def robot_name(urdf: str) -> str:
    """The name that a URDF gives its robot."""
    found = re.search(r"<robot\b[^>]*\bname\s*=\s*[\"']([^\"']*)", urdf)
    return found.group(1) if found else "robot"


def part_of_limit(run: Run) -> Array:
    """Commands as part of the velocity limits, (k, n), signed."""
    result: Array = run.joint_velocity / run.velocity_limits
    return result


def _durations(run: Run) -> Array:
    """How long each tick's command was held, (k,), s; the last one as long as usual."""
    periods = np.diff(run.times_s)
    usual = float(np.median(periods)) if len(periods) else 0.0
    return np.append(periods, usual) if len(run.times_s) else periods


def _rate(times: Array) -> float:
    """Events per second, from the median interval: pauses do not count."""
    if len(times) < 2:
        return math.nan
    period = float(np.median(np.diff(times)))
    return 1.0 / period if period > 0.0 else math.nan


def _ticks(run: Run) -> Ticks:
    periods = 1e3 * np.diff(run.times_s)
    if not len(periods):
        return Ticks(len(run.tick), math.nan, math.nan, math.nan, math.nan, math.nan, 0)
    return Ticks(
        number=len(run.tick),
        rate_hz=float(1e3 / periods.mean()),
        period_median_ms=float(np.median(periods)),
        period_std_ms=float(periods.std()),
        period_p99_ms=float(np.percentile(periods, 99.0)),
        period_max_ms=float(periods.max()),
        missing=int((np.diff(run.tick) - 1).sum()),
    )


def _speed(run: Run) -> Speed:
    finite = np.isfinite(run.joint_velocity)
    parts = np.where(finite, np.abs(part_of_limit(run)), -1.0)
    if not finite.any():
        return Speed(math.nan, "", math.nan, len(parts), 0)
    row, joint = np.unravel_index(int(parts.argmax()), parts.shape)
    return Speed(
        part_of_limit=float(parts[row, joint]),
        joint=run.joints[int(joint)],
        time_s=float(run.times_s[row]),
        non_finite=int((~finite).any(axis=1).sum()),
        over_limit=int((parts > 1.0).any(axis=1).sum()),
    )


def _singularity(run: Run, held_s: Array) -> Singularity:
    last = run.singular_values[:, -1] if run.singular_values.size else np.empty(0)
    known = np.isfinite(last)
    row = int(np.where(known, last, np.inf).argmin()) if known.any() else -1
    lost = run.lost_b[np.isfinite(run.lost_b).all(axis=1)]
    linear, angular = np.linalg.norm(lost[:, :3], axis=1), np.linalg.norm(lost[:, 3:], axis=1)
    with np.errstate(invalid="ignore"):
        lossy = np.abs(run.lost_b).max(axis=1, initial=0.0) > LOST_NOISE
    return Singularity(
        least=float(last[row]) if row >= 0 else math.nan,
        time_s=float(run.times_s[row]) if row >= 0 else math.nan,
        lost_linear_rms=_rms(linear),
        lost_linear_max=float(linear.max(initial=0.0)),
        lost_angular_rms=_rms(angular),
        lost_angular_max=float(angular.max(initial=0.0)),
        lossy_s=float(held_s[lossy].sum()),
    )


def _nearness(run: Run) -> Nearness:
    known = np.isfinite(run.clearance)
    if not known.any():
        return Nearness(math.nan, math.nan, ())
    row = int(np.where(known, run.clearance, np.inf).argmin())
    return Nearness(float(run.clearance[row]), float(run.times_s[row]), run.closest_pair[row])


def _scaling(run: Run, held_s: Array) -> Scaling:
    known = np.isfinite(run.scale)
    with np.errstate(invalid="ignore"):
        slowed = run.scale < 1.0
    times: dict[str, float] = {}
    for names, duration in zip(run.binding, held_s.tolist(), strict=True):
        for name in names:
            times[name] = times.get(name, 0.0) + duration
    return Scaling(
        least=float(run.scale[known].min()) if known.any() else math.nan,
        slowed_s=float(held_s[slowed].sum()),
        binding=tuple(sorted(times.items(), key=lambda item: (-item[1], item[0]))),
    )


def _periods(run: Run, held_s: Array) -> tuple[Period, ...]:
    times: dict[tuple[str, str], float] = {}
    for status, duration in zip(run.status, held_s.tolist(), strict=True):
        key = (status.mode.value, status.reason)
        times[key] = times.get(key, 0.0) + duration
    longest = sorted(times.items(), key=lambda item: (-item[1], item[0]))
    return tuple(Period(mode, reason, duration) for (mode, reason), duration in longest)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0

"""The interval in which the tool is farthest from the trajectory, and what the recording has about it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.step import CLOSED_LOOP, FASTER
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.lateness import deliveries, expected_rate_hz, hold_ups, late_rows, target_age_s
from ik_node.report.tracking import TrackingSeries

OFF_M = 1e-3
"""The tool is off the trajectory beyond this position error; a good run of the demonstration stays below 0.1 mm."""
OFF_RAD = 5e-3
"""The same for the orientation: 1 mm at 0.2 m from the tool."""
FRACTION_OF_PEAK = 0.1
"""The interval ends where the error is below this fraction of its peak."""
GAP_S = 0.3
"""Two intervals with less time between them are one."""
CAUSE_S = 0.2
"""A cause is also looked for in this time before the interval."""
TARGET_CAUSE_S = 1.0
"""The same for lost and late targets: after a gap the reference returns to the trajectory within its bounds."""
HELD_SCALE = 0.05
"""Task scale below which the tool is held."""
TRUNCATION = 1e-6
"""A part of a twist (m/s, rad/s) below this is not given up but rounded."""


class StatePeriod(NamedTuple):
    """Total time in one mode with one reason."""

    mode: str
    reason: str
    duration_s: float


class DeviationTiming(NamedTuple):
    """Control steps in the interval."""

    steps_hz: float
    """Control steps per second."""
    expected_hz: float
    """``rate_hz``, or the rate of the joint states when that is lower."""
    late_by_machine: int
    """Late control steps due to the machine of the node."""
    late_by_states: int
    """Late control steps due to late joint states."""
    hold_ups: int
    """Times in which the node made no call."""
    hold_ups_s: float
    """All of them together."""


class DeviationTargets(NamedTuple):
    """Targets in the interval and in the time ``TARGET_CAUSE_S`` before."""

    lost: int
    age_max_ms: float
    """Largest age of the newest target; NaN without a stream."""
    sample_period_ms: float
    """Median interval of the targets of the run; NaN for fewer than two."""


class DeviationLimits(NamedTuple):
    """What slowed, stopped or diverted the arm in the interval."""

    truncated_s: float
    """Time in which a component of the twist was given up near a singularity."""
    slowed_s: float
    """Time with s < 1."""
    held_s: float
    """Time with s < ``HELD_SCALE``."""
    off_direction_s: float
    binding: tuple[tuple[str, float], ...]
    """(limit, time for which it slowed the arm in s), longest first."""
    off_direction: tuple[tuple[str, float], ...]
    """(limit that forced the tool off its direction, time in s), longest first."""
    stops: tuple[StatePeriod, ...]
    """Times without closed loop, longest first."""
    too_fast: str
    """Status text about targets faster than the reference may be; empty for none."""


class Deviation(NamedTuple):
    """The interval around the largest error.

    Its causes are those of the interval and the time ``CAUSE_S`` before.
    """

    begin_s: float
    end_s: float
    peak_s: float
    position_mm: float
    """Largest position error, tool to trajectory."""
    orientation_mrad: float
    reference_part: float
    """Error reference to trajectory divided by the error tool to trajectory, where that is largest."""
    timing: DeviationTiming
    targets: DeviationTargets
    limits: DeviationLimits

    @property
    def span_s(self) -> float:
        """Duration of the interval with the time before."""
        return self.end_s - self.begin_s + CAUSE_S


def largest_deviation(run: Run, series: TrackingSeries, durations_s: Array) -> Deviation | None:
    """The interval around the largest error of the settled part; of all, when nothing is settled.

    The interval may begin before the settled part.

    Args:
        run: The recorded run.
        series: Its errors over time.
        durations_s: Duration of each command, (k,), s.

    Returns:
        None when the tool is nowhere farther off than ``OFF_M`` and ``OFF_RAD``.
    """
    counts = series.settled if series.settled.any() else series.inside
    error = series.tool_to_trajectory
    ratio = np.where(series.inside, np.maximum(error.position / OFF_M, error.orientation / OFF_RAD), 0.0)
    peak = int(np.where(counts, ratio, 0.0).argmax()) if len(ratio) else -1
    if peak < 0 or ratio[peak] <= 1.0:
        return None
    near = _without_gaps(ratio > max(1.0, FRACTION_OF_PEAK * float(ratio[peak])), series.times_s)
    first, last = _bounds(near, peak)
    begin_s, end_s = float(series.times_s[first]), float(series.times_s[last])
    inside = slice(first, last + 1)
    reference = series.reference_to_trajectory
    part = max(reference.position[peak] / OFF_M, reference.orientation[peak] / OFF_RAD) / ratio[peak]
    rows = (run.times_s >= begin_s - CAUSE_S) & (run.times_s <= end_s)
    return Deviation(
        begin_s=begin_s,
        end_s=end_s,
        peak_s=float(series.times_s[peak]),
        position_mm=1e3 * float(error.position[inside].max()),
        orientation_mrad=1e3 * float(error.orientation[inside].max()),
        reference_part=float(part),
        timing=_timing(run, rows, begin_s - CAUSE_S, end_s),
        targets=_targets(run, begin_s - TARGET_CAUSE_S, end_s),
        limits=_limits(run, rows, durations_s),
    )


def _without_gaps(near: NDArray[np.bool_], times_s: Array) -> NDArray[np.bool_]:
    """``near`` with the gaps filled that are shorter than ``GAP_S``."""
    rows = np.flatnonzero(near)
    filled = np.array(near)
    for first, last in zip(rows[:-1].tolist(), rows[1:].tolist(), strict=True):
        if last > first + 1 and times_s[last] - times_s[first] < GAP_S:
            filled[first:last] = True
    return filled


def _bounds(near: NDArray[np.bool_], peak: int) -> tuple[int, int]:
    """First and last row of the rows around ``peak`` that are ``near``."""
    away = np.flatnonzero(~near)
    index = int(np.searchsorted(away, peak))
    first = int(away[index - 1]) + 1 if index else 0
    last = int(away[index]) - 1 if index < len(away) else len(near) - 1
    return first, last


def _timing(run: Run, rows: NDArray[np.bool_], begin_s: float, end_s: float) -> DeviationTiming:
    late, waits = late_rows(run), hold_ups(run)
    here = rows[1:]
    ended = (waits.end_s > begin_s) & (waits.end_s - waits.duration_s < end_s)
    begins = np.maximum(waits.end_s - waits.duration_s, begin_s)
    span_s = end_s - max(begin_s, 0.0)
    by_machine = int((late.by_machine & here).sum())
    return DeviationTiming(
        steps_hz=float(rows.sum()) / span_s if span_s > 0.0 else math.nan,
        expected_hz=expected_rate_hz(run),
        late_by_machine=by_machine,
        late_by_states=int((late.late & here).sum()) - by_machine,
        hold_ups=int(ended.sum()),
        hold_ups_s=float((np.minimum(waits.end_s, end_s) - begins)[ended].sum()),
    )


def _targets(run: Run, begin_s: float, end_s: float) -> DeviationTargets:
    times, counts = run.targets.times_s, deliveries(run)
    first, last = np.searchsorted(times, begin_s, side="left"), np.searchsorted(times, end_s, side="right")
    age = target_age_s(run)[(run.times_s >= begin_s) & (run.times_s <= end_s)]
    known = age[np.isfinite(age)]
    return DeviationTargets(
        lost=counts[int(last)].lost - counts[int(first)].lost,
        age_max_ms=1e3 * float(known.max()) if len(known) else math.nan,
        sample_period_ms=1e3 * float(np.median(np.diff(times))) if len(times) > 1 else math.nan,
    )


def _limits(run: Run, rows: NDArray[np.bool_], durations_s: Array) -> DeviationLimits:
    chosen = np.flatnonzero(rows)
    scale, duration = run.scale[chosen], durations_s[chosen]
    with np.errstate(invalid="ignore"):
        slowed, held = scale < 1.0, scale < HELD_SCALE
        truncated = np.abs(run.truncated_b[chosen]).max(axis=1, initial=0.0) > TRUNCATION
        off = np.array([bool(run.off_direction_limits[row]) for row in chosen], dtype=bool)
    binding: dict[str, float] = {}
    forcing: dict[str, float] = {}
    stops: dict[tuple[str, str], float] = {}
    too_fast = ""
    for index, row in enumerate(chosen.tolist()):
        seconds = float(duration[index])
        for name in run.binding[row] if slowed[index] else ():
            binding[name] = binding.get(name, 0.0) + seconds
        for name in run.off_direction_limits[row][:1]:
            forcing[name] = forcing.get(name, 0.0) + seconds
        status = run.status[row]
        if status.mode not in CLOSED_LOOP:
            key = (status.mode.value, status.reason)
            stops[key] = stops.get(key, 0.0) + seconds
        if FASTER in status.reason:
            too_fast = next(text for text in status.reason.split("; ") if FASTER in text)
    return DeviationLimits(
        truncated_s=float(duration[truncated].sum()),
        slowed_s=float(duration[slowed].sum()),
        held_s=float(duration[held].sum()),
        off_direction_s=float(duration[off].sum()),
        binding=longest_first(binding),
        off_direction=longest_first(forcing),
        stops=longest_states(stops),
        too_fast=too_fast,
    )


def longest_first(times: dict[str, float]) -> tuple[tuple[str, float], ...]:
    """(name, time in s), the longest time first."""
    return tuple(sorted(times.items(), key=lambda item: (-item[1], item[0])))


def longest_states(times: dict[tuple[str, str], float]) -> tuple[StatePeriod, ...]:
    """(mode, reason) -> time in s as periods, the longest first."""
    longest = sorted(times.items(), key=lambda item: (-item[1], item[0]))
    return tuple(StatePeriod(mode, reason, duration) for (mode, reason), duration in longest)

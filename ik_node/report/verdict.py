"""The result of a run in one sentence, computed from its metrics."""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from ik_node.interfaces.step import OFF_DIRECTION, Mode
from ik_node.report.deviation import Deviation
from ik_node.report.metrics import RunMetrics
from ik_node.report.style import GREEN, GREY, RED

MIN_PART = 0.1
"""A condition explains a deviation when it lasted for this fraction of it."""
MIN_HOLD_UP_S = 0.03
"""Shorter hold-ups explain no deviation."""
BUSY_PART = 0.8
"""Control steps per second, relative to the expected ones, below which a computer is busy."""
REFERENCE_PART = 0.5
"""Part of the error beyond which it is that of the reference, which limits of the arm do not explain."""
MIN_LAG_MS = 10.0
LATE_PERIODS = 3.0
"""A target older than this many sample periods explains a deviation of the reference."""
MIN_SLOWED_S = 0.005
"""Shorter times with s < 1 are not mentioned."""
STOPPING = (Mode.STOPPED.value, Mode.FAULT.value)


class Cause(Enum):
    """What explains the result of a run; the values are those of the column ``cause`` of a table of runs."""

    TRACKED = "tracked"
    STOPPED = "stopped"
    BUSY = "busy computer"
    LATE_STATES = "late joint states"
    TARGETS = "targets late or lost"
    SINGULARITY = "given up at a singularity"
    HELD_OFF = "held off"
    SLOWED = "slowed by limits"
    OFF_DIRECTION = "off its direction"
    TOO_FAST = "target too fast"
    LAG = "lag"
    REFERENCE = "reference off the trajectory"
    UNKNOWN = "no recorded cause"
    NO_TARGET = "no target"


CAUSE_COLOURS = {Cause.TRACKED: GREEN, Cause.NO_TARGET: GREY, Cause.STOPPED: RED, Cause.SINGULARITY: RED}
"""Colour of the bar beside a verdict; amber for all other causes."""


class Verdict(NamedTuple):
    """The result of a run."""

    text: str
    """One sentence, with a full stop."""
    cause: Cause


class _Explanation(NamedTuple):
    cause: Cause
    text: str


def verdict(metrics: RunMetrics, zero_s: float = 0.0) -> Verdict:
    """The result of a run in one sentence: how well it tracked, or where it did not and why.

    Args:
        metrics: Of the run.
        zero_s: Time on the axis of ``Run.times_s`` that is called 0 in the sentence.
    """
    stopped = _longest_stop(metrics)
    deviation = metrics.deviation
    if stopped is not None:
        off = f"; tool up to {_size(deviation)} off" if deviation is not None else ""
        return Verdict(f"Stopped for {stopped[0]:.2f} s: {stopped[1]}{off}.", Cause.STOPPED)
    if deviation is None:
        return _without_deviation(metrics)
    cause, text = _explanation(metrics, deviation)
    subject = "Tool" if deviation.position_mm > 0.2 * deviation.orientation_mrad else "Tool turned"
    where = f"from {deviation.begin_s - zero_s:.1f} to {deviation.end_s - zero_s:.1f} s"
    return Verdict(f"{subject} {_size(deviation)} off {where}: {text}.", cause)


def _longest_stop(metrics: RunMetrics) -> tuple[float, str] | None:
    """Time with zero velocity at once, and the reason that lasted longest; None for none."""
    stops = [period for period in metrics.periods if period.mode in STOPPING]
    return (sum(period.duration_s for period in stops), stops[0].reason) if stops else None


def _without_deviation(metrics: RunMetrics) -> Verdict:
    rest = "; ".join((_slowed(metrics), *_notes(metrics)))
    if metrics.tracking is not None:
        errors = metrics.tracking.settled
        if math.isnan(errors.position_rms_mm):
            errors = metrics.tracking.overall
        if math.isfinite(errors.position_rms_mm):
            return Verdict(f"Tracked to {_millimetres(errors.position_rms_mm)} RMS; {rest}.", Cause.TRACKED)
    if math.isfinite(metrics.tool_to_reference.position_rms_mm):
        error = _millimetres(metrics.tool_to_reference.position_rms_mm)
        return Verdict(f"No trajectory to compare with; tool to reference {error} RMS; {rest}.", Cause.NO_TARGET)
    longest = metrics.periods[0] if metrics.periods else None
    reason = "" if longest is None else f": {longest.mode}, {longest.reason}"
    return Verdict(f"The arm was never controlled in closed loop{reason}.", Cause.NO_TARGET)


def _slowed(metrics: RunMetrics) -> str:
    scaling = metrics.scaling
    if scaling.slowed_s < MIN_SLOWED_S:
        return "never slowed"
    by = f" by {_limit(scaling.slowed_by[0][0])}" if scaling.slowed_by else ""
    return f"slowed for {scaling.slowed_s:.2f} s{by}"


def _notes(metrics: RunMetrics) -> list[str]:
    """What happened without an effect on the error."""
    notes = []
    if metrics.singularity.truncated_s > 0.0:
        notes.append(f"a direction given up at a singularity for {metrics.singularity.truncated_s:.2f} s")
    if metrics.late_targets.lost:
        notes.append(_lost(metrics.late_targets.lost, metrics))
    if metrics.late_steps.hold_ups_s > MIN_HOLD_UP_S:
        notes.append(f"this computer held up the node for {metrics.late_steps.hold_ups_s:.2f} s")
    if not metrics.complete:
        notes.append("the recording is truncated")
    return notes


def _explanation(metrics: RunMetrics, deviation: Deviation) -> _Explanation:
    """The first condition that lasted long enough, from those that other conditions follow from."""
    checks = (_stop, _timing, _late_targets, _limits, _motion)
    return next(filter(None, (check(metrics, deviation) for check in checks)), _unknown(deviation))


def _stop(metrics: RunMetrics, deviation: Deviation) -> _Explanation | None:
    del metrics
    for stop in deviation.limits.stops[:1]:
        if stop.duration_s >= MIN_PART * deviation.span_s:
            return _Explanation(Cause.STOPPED, f"{stop.mode} for {stop.duration_s:.2f} s, {stop.reason}")
    return None


def _timing(metrics: RunMetrics, deviation: Deviation) -> _Explanation | None:
    del metrics
    timing = deviation.timing
    rate = f"{timing.steps_hz:.0f} of {timing.expected_hz:.0f} control steps a second"
    slow = timing.steps_hz < BUSY_PART * timing.expected_hz
    if timing.hold_ups > 1 and slow and timing.late_by_machine >= max(timing.late_by_states, 1):
        return _Explanation(Cause.BUSY, f"this computer was busy, {rate}")
    if timing.hold_ups_s >= max(MIN_HOLD_UP_S, MIN_PART * deviation.span_s):
        return _Explanation(Cause.BUSY, f"this computer held up the node for {timing.hold_ups_s:.2f} s")
    if slow and timing.late_by_states:
        return _Explanation(Cause.LATE_STATES, f"joint states came late, {rate}")
    return None


def _late_targets(metrics: RunMetrics, deviation: Deviation) -> _Explanation | None:
    targets = deviation.targets
    if deviation.reference_part < REFERENCE_PART:
        return None
    if targets.lost:
        return _Explanation(Cause.TARGETS, _lost(targets.lost, metrics))
    if targets.age_max_ms > LATE_PERIODS * targets.sample_period_ms:
        age = f"the newest was up to {targets.age_max_ms:.0f} ms old"
        return _Explanation(Cause.TARGETS, f"targets came late, {age}")
    return None


def _lost(lost: int, metrics: RunMetrics) -> str:
    total = metrics.targets + metrics.late_targets.lost
    return f"{lost} of {total} targets {'was' if lost == 1 else 'were'} lost"


def _limits(metrics: RunMetrics, deviation: Deviation) -> _Explanation | None:
    del metrics
    limits, least_s = deviation.limits, MIN_PART * deviation.span_s
    if deviation.reference_part >= REFERENCE_PART:
        return None
    dampers = [name for name, time_s in limits.binding if name.startswith("damper ") and time_s >= least_s]
    if limits.held_s >= least_s and dampers:
        return _Explanation(Cause.HELD_OFF, f"held off for {limits.held_s:.2f} s by {_limit(dampers[0])}")
    if limits.truncated_s >= least_s:
        text = f"a direction was given up at a singularity for {limits.truncated_s:.2f} s"
        return _Explanation(Cause.SINGULARITY, text)
    if limits.slowed_s >= least_s:
        by = f"by {_limit(limits.binding[0][0])}" if limits.binding else "near a singularity"
        return _Explanation(Cause.SLOWED, f"slowed for {limits.slowed_s:.2f} s {by}")
    if limits.off_direction_s >= least_s:
        forced = f"forced by {_limit(limits.off_direction[0][0])}"
        return _Explanation(Cause.OFF_DIRECTION, f"{OFF_DIRECTION}, {forced}")
    return None


def _motion(metrics: RunMetrics, deviation: Deviation) -> _Explanation | None:
    tracking = metrics.tracking
    if deviation.limits.too_fast:
        return _Explanation(Cause.TOO_FAST, deviation.limits.too_fast)
    if tracking is not None and tracking.lag_position_ms > MIN_LAG_MS:
        least = 0.5 * tracking.settled.position_rms_mm
        if tracking.position_rms_without_lag_mm < least:
            return _Explanation(Cause.LAG, f"the tool lags by {tracking.lag_position_ms:.0f} ms")
    if deviation.reference_part >= REFERENCE_PART:
        return _Explanation(Cause.REFERENCE, "the reference itself was off the trajectory")
    return None


def _unknown(deviation: Deviation) -> _Explanation:
    part = f"{100.0 * max(1.0 - deviation.reference_part, 0.0):.0f} % of it tool to reference"
    return _Explanation(Cause.UNKNOWN, f"no cause was recorded, {part}")


def _limit(name: str) -> str:
    """``velocity joint4`` -> ``the velocity limit of joint4``; ``damper a - b`` -> ``the distance a - b``."""
    kind, _, rest = name.partition(" ")
    return f"the distance {rest}" if kind == "damper" else f"the {kind} limit of {rest}"


def _size(deviation: Deviation | None) -> str:
    if deviation is None:
        return ""
    if deviation.position_mm > 0.2 * deviation.orientation_mrad:
        return _millimetres(deviation.position_mm)
    return f"{deviation.orientation_mrad:.0f} mrad"


def _millimetres(value: float) -> str:
    """A length with two significant digits."""
    if value < 0.001:
        return "less than 0.001 mm"
    if value >= 10.0:
        return f"{value:.0f} mm"
    return f"{value:.1f} mm" if value >= 1.0 else f"{value:.2g} mm"

"""What came late in a run: targets, joint states and control steps; and hold-ups of the node, from the recorded calls.

The definitions are those of the node: :mod:`ik_node.interfaces.delivery`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.delivery import HOLD_UP_S, LATE_PERIODS, StreamDelivery, delivered, target_times
from ik_node.interfaces.step import CLOSED_LOOP
from ik_node.math.types import Array
from ik_node.recording.run import Run


class AgeMetrics(NamedTuple):
    """Age at the control steps; NaN without any."""

    median_ms: float
    p95_ms: float
    max_ms: float


class LateTargetMetrics(NamedTuple):
    """Targets of the stream that came late or are missing; see :class:`~ik_node.interfaces.delivery.StreamDelivery`."""

    late: int
    lost: int
    age: AgeMetrics
    """Of the newest target, since its stamp, in closed loop while a stream lasts."""


class LateStepMetrics(NamedTuple):
    """Control steps that came late in closed loop, and hold-ups: times in which the node made no call."""

    late: int
    """Control steps later than two control periods after the one before."""
    by_machine: int
    """Those with a hold-up in between, or whose joint state was measured in time and waited. For the others the joint
    state itself was late."""
    held_too_long: int
    """Commands that were held for longer than ``limits.hold_periods``."""
    state_age: AgeMetrics
    """Of the joint state, since its stamp."""
    hold_ups: int
    hold_ups_s: float
    hold_up_max_ms: float
    """0 for none."""


class HoldUps(NamedTuple):
    """Times in which the node made no call, in the order of time."""

    end_s: Array
    """(h,), on the axis of ``Run.times_s``."""
    duration_s: Array
    """(h,)"""


def late_targets(run: Run) -> LateTargetMetrics:
    """Late and lost targets of a run."""
    delivery = deliveries(run)[-1]
    return LateTargetMetrics(delivery.late, delivery.lost, _age(target_age_s(run)))


class LateRows(NamedTuple):
    """Which control steps came late, (k - 1,): entry i is that of step i + 1."""

    late: NDArray[np.bool_]
    by_machine: NDArray[np.bool_]
    """Those that the machine of the node delayed."""


def late_rows(run: Run) -> LateRows:
    """Late control steps of a run."""
    found = hold_ups(run)
    begin, end = run.times_s[:-1], run.times_s[1:]
    limit_s = LATE_PERIODS / expected_rate_hz(run)
    late = _counted(run) & (end - begin > limit_s)
    waited = np.diff(run.state_times_s) <= limit_s
    held_up = np.searchsorted(found.end_s, end, side="right") > np.searchsorted(found.end_s, begin, side="right")
    return LateRows(late, late & (held_up | waited))


def _counted(run: Run) -> NDArray[np.bool_]:
    """Intervals in closed loop between consecutive control steps, (k - 1,)."""
    return np.asarray(closed_loop(run)[:-1] & (np.diff(run.tick) == 1))


def late_steps(run: Run) -> LateStepMetrics:
    """Late control steps and hold-ups of a run."""
    found, rows = hold_ups(run), late_rows(run)
    hold_s = setting(run, "limits.hold_periods") / expected_rate_hz(run)
    return LateStepMetrics(
        late=int(rows.late.sum()),
        by_machine=int(rows.by_machine.sum()),
        held_too_long=int((_counted(run) & (np.diff(run.times_s) > hold_s)).sum()),
        state_age=_age((run.times_s - run.state_times_s)[closed_loop(run)]),
        hold_ups=len(found.end_s),
        hold_ups_s=float(found.duration_s.sum()),
        hold_up_max_ms=1e3 * float(found.duration_s.max(initial=0.0)),
    )


def hold_ups(run: Run) -> HoldUps:
    """Hold-ups of a run. A pause of the node, which ends with ``resume``, is none."""
    duration_s = np.diff(run.calls.times_s)
    is_hold_up = (duration_s > HOLD_UP_S) & ~run.calls.resumed[1:]
    return HoldUps(run.calls.times_s[1:][is_hold_up], duration_s[is_hold_up])


def target_age_s(run: Run) -> Array:
    """Age of the newest target at each control step, (k,), s.

    NaN before the first target of a stream and after its last one, which no other follows within ``target.timeout_s``;
    and where the control law is not active.
    """
    newest = np.searchsorted(run.targets.times_s, run.times_s, side="right")
    taken_s = np.array([np.nan, *(delivery.time_ns / NS for delivery in deliveries(run)[1:])])
    gap_s = np.diff(run.targets.times_s, prepend=-np.inf, append=np.inf)
    active = closed_loop(run) & (gap_s[newest] <= setting(run, "target.timeout_s"))
    result: Array = np.where(active, run.times_s - taken_s[newest], np.nan)
    return result


def deliveries(run: Run) -> list[StreamDelivery]:
    """Counts of late and lost targets: before the first target, and after each."""
    found, timeout_s, targets = [StreamDelivery()], setting(run, "target.timeout_s"), run.targets
    stamps = zip(targets.times_s.tolist(), targets.received_ros_ns.tolist(), targets.stamp_ns.tolist(), strict=True)
    for time_s, ros_ns, stamp_ns in stamps:
        now = Instant(round(time_s * NS), ros_ns)
        found.append(delivered(found[-1], target_times(stamp_ns, now), timeout_s))
    return found


def _age(values_s: Array) -> AgeMetrics:
    known = 1e3 * values_s[np.isfinite(values_s)]
    if not len(known):
        return AgeMetrics(math.nan, math.nan, math.nan)
    return AgeMetrics(float(np.median(known)), float(np.percentile(known, 95.0)), float(known.max()))


def closed_loop(run: Run) -> NDArray[np.bool_]:
    """Control steps in which the control law computed the command, (k,)."""
    return np.array([status.mode in CLOSED_LOOP for status in run.status], dtype=bool)


def setting(run: Run, name: str) -> float:
    """Value of a parameter at the start; NaN when it was not recorded."""
    value = run.settings.get(name)
    return float(value) if isinstance(value, (int, float)) else math.nan


def expected_rate_hz(run: Run) -> float:
    """``rate_hz``, or the rate of the joint states when that is clearly lower."""
    rate_hz = setting(run, "rate_hz")
    periods = np.diff(run.state_times_s[np.isfinite(run.state_times_s)])
    median_s = float(np.median(periods)) if len(periods) else 0.0
    return 1.0 / median_s if median_s * rate_hz > 1.5 else rate_hz

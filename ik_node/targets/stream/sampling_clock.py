"""Sampling clock of a stream: the sample period, and the time at which a sample was taken.

A stream is sampled regularly, but stamped or delivered irregularly. A phase-locked estimate (a fading-memory line
through the stamps, exact for a stream without jitter) gives the regular time of each sample.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled

UNKNOWN_PERIOD_S = 0.05
"""Assumed sample period until two samples have arrived."""
INTERVALS = 15
"""Number of intervals between samples from which the period is estimated."""
MEMORY = 0.9
"""Forgetting factor of the phase-locked estimate, per sample."""
SPREAD_MEMORY = 0.95
"""Forgetting factor of the variance of the jitter, per sample."""
MOST_MISSED = 4
"""After more lost samples than this the estimate starts anew."""
LARGEST_RESIDUAL = 0.6
"""A sample whose residual exceeds this fraction of a period starts the estimate anew."""
LARGEST_DISAGREEMENT = 0.15
"""Largest difference of the phase-locked period from the mean interval, as a fraction of the period."""
CLEARLY_BETTER = 0.7
"""Another count of the steps is used if its squared misfit is below this fraction of the first one's."""
LARGEST_DELAY = 0.25
"""Largest mean delay, in periods, that is compensated."""


class SamplingClock(NamedTuple):
    """Estimates after the newest sample of a stream."""

    time_ns: int = 0
    """Stamp of the newest sample."""
    intervals: tuple[int, ...] = ()
    """Between the newest samples [ns]."""
    period_s: float = UNKNOWN_PERIOD_S
    """Mean interval, lost samples counted."""
    age: int = 0
    """Number of samples since the estimate began; 0 before the first."""
    locked_period_s: float = 0.0
    """Period of the phase-locked estimate."""
    offset_s: float = 0.0
    """Regular time of the newest sample, less its stamp."""
    variance: float = 0.0
    """Of the stamps about the regular times [s2]."""

    @property
    def delay_s(self) -> float:
        """Mean delay of the arrivals, from their variance: that of delays distributed evenly from 0 on."""
        return min(sqrt(3.0 * self.variance), LARGEST_DELAY * self.period_s)


def reset(clock: SamplingClock, time_ns: int) -> SamplingClock:
    """The estimate starts anew at this sample; the period is kept until there is a better one."""
    return clock._replace(time_ns=time_ns, age=1, offset_s=0.0)


def updated(clock: SamplingClock, time_ns: int) -> SamplingClock:
    """The estimate with one more sample, later than the newest."""
    interval = time_ns - clock.time_ns
    intervals = (*clock.intervals[1 - INTERVALS :], interval)
    mean_s = _period(np.array(intervals, dtype=np.int64), clock.period_s * NS)
    # a short line has a worse slope than the mean interval; a long one must agree with it, else steps were lost
    locked_period_s = clock.locked_period_s
    if clock.age < INTERVALS or abs(locked_period_s - mean_s) > LARGEST_DISAGREEMENT * mean_s:
        locked_period_s = mean_s
    known = clock._replace(intervals=intervals, period_s=locked_period_s)
    since_s = interval / NS - clock.offset_s
    steps = max(1, round(since_s / locked_period_s))
    residual_s = since_s - steps * locked_period_s
    if steps > MOST_MISSED or abs(residual_s) > LARGEST_RESIDUAL * locked_period_s:
        return reset(known, time_ns)
    # gains of a fading-memory line (Morrison, Introduction to Sequential Smoothing and Prediction, 1969), whose
    # memory grows from the last two samples
    n = clock.age + 1.0
    gain = max(1.0 - MEMORY**2, (4.0 * n - 2.0) / (n * (n + 1.0)))
    return known._replace(
        time_ns=time_ns,
        age=clock.age + 1,
        locked_period_s=locked_period_s + (1.0 - MEMORY) ** 2 * residual_s / steps,
        offset_s=(gain - 1.0) * residual_s,
        variance=SPREAD_MEMORY * clock.variance + (1.0 - SPREAD_MEMORY) * residual_s * residual_s,
    )


@compiled
def _period(intervals: NDArray[np.int64], known: float) -> float:
    """Time over steps [s]: the jitter of all samples but the first and last cancels.

    Steps are counted with the median, which is itself off by part of the jitter; the period ``known`` [ns] counts
    them if they then fit clearly better.
    """
    period, misfit = _counted(intervals, float(np.sort(intervals)[(len(intervals) - 1) // 2]))
    other, other_misfit = _counted(intervals, known)
    return (other if other_misfit < CLEARLY_BETTER * misfit else period) / NS


@compiled
def _counted(intervals: NDArray[np.int64], guess: float) -> tuple[float, float]:
    """Period [ns] when steps are counted with ``guess``, and the mean squared misfit in steps."""
    period, steps = guess, np.empty(len(intervals), dtype=np.int64)
    for _ in range(2):
        time_ns = count = 0
        for i, interval in enumerate(intervals):
            steps[i] = max(1, round(interval / period))
            if steps[i] <= MOST_MISSED:
                time_ns, count = time_ns + interval, count + steps[i]
        if count == 0:
            return guess, inf
        period = time_ns / count
    misfit, near = 0.0, 0
    for i, interval in enumerate(intervals):
        if steps[i] <= MOST_MISSED:
            misfit, near = misfit + (interval / period - steps[i]) ** 2, near + 1
    return period, misfit / near

"""The rhythm of a stream: its sample period, and when a sample really was taken.

A stream is sampled regularly and stamped or delivered irregularly. A phase-locked estimate (a fading-memory line
through the stamps, so exact for a stream without jitter) says when the sample should have come.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled

UNKNOWN_PERIOD_S = 0.05
"""Sample period that is assumed until two samples have come."""
INTERVALS = 15
"""Intervals between samples from which the period is taken."""
MEMORY = 0.9
"""Weight of the past in the phase-locked estimate, per sample."""
SPREAD_MEMORY = 0.95
"""The same in the jitter's variance."""
MOST_MISSED = 4
"""After more lost samples than this the rhythm is learnt anew."""
LARGEST_RESIDUAL = 0.6
"""A sample further than this part of a period from where the rhythm puts it starts a new rhythm."""
LARGEST_DISAGREEMENT = 0.15
"""Between the phase-locked period and the mean interval, as part of the period."""
CLEARLY_BETTER = 0.7
"""Part of the squared misfit of steps that another count of them must not exceed."""
LARGEST_DELAY = 0.25
"""Mean delay, in periods, that is believed at most."""


class SamplingClock(NamedTuple):
    """What is known of a stream's rhythm after its newest sample."""

    time_ns: int = 0
    """Stamp of the newest sample."""
    intervals: tuple[int, ...] = ()
    """Between the newest samples [ns]."""
    period_s: float = UNKNOWN_PERIOD_S
    """Mean interval, lost samples counted."""
    age: int = 0
    """Samples since the rhythm began; 0 before the first."""
    locked_period_s: float = 0.0
    """Period of the phase-locked estimate."""
    offset_s: float = 0.0
    """Regular time of the newest sample, less its stamp."""
    variance: float = 0.0
    """Of the stamps about the regular times [s2]."""

    @property
    def delay_s(self) -> float:
        """Mean delay of the arrivals, from their spread: that of delays spread evenly from 0 on."""
        return min(sqrt(3.0 * self.variance), LARGEST_DELAY * self.period_s)


def reset(clock: SamplingClock, time_ns: int) -> SamplingClock:
    """The rhythm begins at this sample; the period is kept until it is known better."""
    return clock._replace(time_ns=time_ns, age=1, offset_s=0.0)


def updated(clock: SamplingClock, time_ns: int) -> SamplingClock:
    """The rhythm with one more sample, later than the newest."""
    interval = time_ns - clock.time_ns
    intervals = (*clock.intervals[1 - INTERVALS :], interval)
    mean_s = _period(np.array(intervals, dtype=np.int64), clock.period_s * NS)
    # until the line is long its slope is worse than the mean interval; later it must agree, else it has lost steps
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

"""What is late: bounds for control steps and calls; numbers of received, late and lost samples of a stream.

Node and report use these definitions; of a stream they need the times of arrival and the header stamps alone.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS, Instant, Stamped, to_monotonic

MAX_STAMP_AGE_S = 1.0
"""If the stamp of a target is older than this, the time of arrival is used instead."""
MAX_AGE_NS = round(MAX_STAMP_AGE_S * NS)
MAX_AHEAD_NS = NS // 2
"""Target stamps up to this far in the future (look-ahead of a planner) are plausible."""
CLOCK_PERIOD_S = 0.01
"""Period of the clock calls of the controller, which detect missing inputs."""
HOLD_UP_S = 1.2 * CLOCK_PERIOD_S
"""A longer time without joint state and clock call is a hold-up; less is the accuracy of the timers."""
LATE_PERIODS = 2.0
"""A joint state that makes a control step is late when it arrives more than this many periods of ``rate_hz`` after the
last one."""
INTERVALS = 15
"""Number of intervals between samples whose median is the period."""
SHORTEST_PERIOD_NS = NS // 50
"""Smallest period for late samples and gaps: networks delay fast streams by several periods."""
MISSING = 1.5
"""Ratio of an interval to the period above which samples are missing in it."""
EARLY = 0.5
"""Ratio of an interval to the period, or to the mean interval, below which two samples were sent or delivered together.

Such a sample without stamp is one that was missing before; such an interval does not count for the period."""


class StreamDelivery(NamedTuple):
    """Figures of a stream up to its newest sample."""

    received: int = 0
    late: int = 0
    """Arrived more than one period (at least 20 ms) after their stamp; without stamps: after a gap, together."""
    lost: int = 0
    """Missing between two samples, in periods; after a pause longer than ``target.timeout_s`` a new stream starts."""
    time_ns: int = 0
    """Monotonic time at which the newest sample was taken: its stamp, or its arrival."""
    received_ns: int = 0
    intervals_ns: tuple[int, ...] = ()
    """The last ones between the times of samples."""
    missing: int = 0
    """Samples without stamp that are counted as lost and may still arrive."""

    @property
    def period_ns(self) -> int:
        """Median interval, without those of samples that a sender published together; 0 while few are known."""
        if len(self.intervals_ns) < INTERVALS:
            return 0
        shortest_ns = EARLY * sum(self.intervals_ns) / len(self.intervals_ns)
        regular = sorted(interval for interval in self.intervals_ns if interval > shortest_ns)
        return regular[len(regular) // 2]


def target_times(stamp_ns: int, now: Instant) -> Stamped:
    """Times of a target pose with a header stamp, in ROS time, that arrives at ``now``."""
    return to_monotonic(stamp_ns, now, MAX_AGE_NS, MAX_AHEAD_NS)


def delivered(delivery: StreamDelivery, stamped: Stamped, timeout_s: float) -> StreamDelivery:
    """The figures after a sample.

    Args:
        delivery: The figures before.
        stamped: Times of the sample.
        timeout_s: ``target.timeout_s``.
    """
    time_ns, received_ns, _ = stamped
    period_ns, missing = delivery.period_ns, delivery.missing
    is_late = received_ns - time_ns > max(period_ns, SHORTEST_PERIOD_NS)
    new = delivery._replace(received=delivery.received + 1, late=delivery.late + is_late, received_ns=received_ns)
    interval_ns = time_ns - delivery.time_ns
    if not delivery.received or received_ns - delivery.received_ns > timeout_s * NS:
        return new._replace(time_ns=time_ns, missing=0)
    if missing and interval_ns < EARLY * period_ns:
        return new._replace(time_ns=time_ns, late=new.late + 1, lost=new.lost - 1, missing=missing - 1)
    if interval_ns <= 0:  # repeated; or overtaken by a newer one, which made it count as lost
        is_overtaken = interval_ns < 0 < new.lost
        return new._replace(late=max(new.late, delivery.late + is_overtaken), lost=new.lost - is_overtaken)
    is_gap = 0 < MISSING * period_ns < interval_ns
    lost = round(interval_ns / period_ns) - 1 if is_gap else 0
    return new._replace(
        time_ns=time_ns,
        lost=new.lost + lost,
        missing=lost if time_ns == received_ns else 0,
        intervals_ns=(*delivery.intervals_ns[1 - INTERVALS :], interval_ns),
    )

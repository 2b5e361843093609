"""Intentional delay of the reference behind an unpredictable target of a stream.

Between samples the target is extrapolated; if it is unpredictable, the motion would oscillate about it. A delay of up
to a sample period turns extrapolation into interpolation. A predictable target is followed without delay.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled

PREDICTABLE, UNPREDICTABLE = 0.05, 0.08
"""RMS prediction error relative to the RMS step: no delay up to the first value, the maximum from the second on."""
LATENCY_RATE = 0.1
"""Change of the delay per second, by which the motion is slower or faster during the change."""


class Latency(NamedTuple):
    """A delay that changes to ``goal_s`` at a constant rate."""

    value_s: float = 0.0
    """At ``time_ns``."""
    goal_s: float = 0.0
    time_ns: int = 0

    def moving_to(self, goal_s: float, time_ns: int) -> Latency:
        """The same delay, from ``time_ns`` on changing to another goal."""
        return Latency(latency_at(self, time_ns)[0], goal_s, time_ns)


@compiled
def latency_at(latency: Latency, time_ns: int) -> tuple[float, float]:
    """Delay [s] and its rate of change at ``time_ns``."""
    left = latency.goal_s - latency.value_s
    # a late control step asks for times before the newest sample
    change = LATENCY_RATE * max(0, time_ns - latency.time_ns) / NS
    if abs(left) <= change:
        return latency.goal_s, 0.0
    return (latency.value_s + change, LATENCY_RATE) if left > 0.0 else (latency.value_s - change, -LATENCY_RATE)


def target_latency(unpredictability: float, max_latency_s: float) -> float:
    """Delay [s] for a target of this unpredictability (see :class:`PredictorBank`), at most ``max_latency_s``."""
    part = (unpredictability - PREDICTABLE) / (UNPREDICTABLE - PREDICTABLE)
    return max_latency_s * min(1.0, max(0.0, part))

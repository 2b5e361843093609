"""How far behind a streamed target the motion runs on purpose.

Between samples a target is extrapolated, and where it is hard to foretell the motion would swing about it. Running up
to a sample period late turns extrapolation into interpolation. A predictable target is followed without lag.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled

PREDICTABLE, UNPREDICTABLE = 0.05, 0.08
"""Error of the predictions as part of the way between samples, up to which the motion does not lag, and from which on
it lags by all that is allowed."""
LATENCY_RATE = 0.1
"""Change of the latency per second: the part by which the motion runs slower or faster meanwhile."""


class Latency(NamedTuple):
    """A lag on its way to another."""

    value_s: float = 0.0
    """At ``time_ns``."""
    goal_s: float = 0.0
    time_ns: int = 0

    def moving_to(self, goal_s: float, time_ns: int) -> Latency:
        """The same latency on its way to another."""
        return Latency(latency_at(self, time_ns)[0], goal_s, time_ns)


@compiled
def latency_at(latency: Latency, time_ns: int) -> tuple[float, float]:
    """Latency [s] and its rate of change."""
    left = latency.goal_s - latency.value_s
    # a late tick asks for moments before the newest sample
    change = LATENCY_RATE * max(0, time_ns - latency.time_ns) / NS
    if abs(left) <= change:
        return latency.goal_s, 0.0
    return (latency.value_s + change, LATENCY_RATE) if left > 0.0 else (latency.value_s - change, -LATENCY_RATE)


def target_latency(unpredictability: float, max_latency_s: float) -> float:
    """Latency [s] for a target of this unpredictability (``predictors.PredictorBank``), at most ``max_latency_s``."""
    part = (unpredictability - PREDICTABLE) / (UNPREDICTABLE - PREDICTABLE)
    return max_latency_s * min(1.0, max(0.0, part))

"""Intentional delay of the reference behind an unpredictable target of a stream.

Between samples the target is extrapolated; if it is unpredictable, as motions that a sensor measures with noise, the
motion would oscillate about it. A delay turns extrapolation into smoothing. It is constant: a delay that follows the
quality of the predictions is an error itself, the velocity times its change. A predictable target is followed without
delay. Between the two there is a hysteresis, because the quality of the predictions varies within a motion.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled

PREDICTABLE, UNPREDICTABLE = 0.03, 0.07
"""RMS prediction error relative to the RMS step below which an unpredictable target becomes predictable, and above
which a predictable one becomes unpredictable. Figures of eight at 20 Hz and faster have at most 0.053, with jitter of
0.4 periods and lost samples; orientations that a hand or a camera moves have more than 0.13. Within one motion the
value varies by a factor of 2, positions of a hand-held camera at 50 Hz from 0.047 to 0.077."""


class SmoothingDelay(NamedTuple):
    """Delay behind an unpredictable target, as a function of the sample period."""

    periods: float
    """In sample periods, for slow streams."""
    least_s: float
    """For faster ones: within a shorter time, noise cannot be followed with limited acceleration."""
    most_periods: float
    """For very fast ones: with this many periods nothing is left to smooth."""

    def at(self, period_s: float) -> float:
        """The delay [s] for a sample period [s]."""
        return min(max(self.periods * period_s, self.least_s), self.most_periods * period_s)


LINEAR_DELAY = SmoothingDelay(0.75, 0.025, 2.0)
"""Of a position. With 0.55 periods the error of a random walk at 20 Hz with lost samples is 1.08 times that of P
control at 10 1/s, with 0.75 it is less."""
ANGULAR_DELAY = SmoothingDelay(1.15, 0.037, 4.0)
"""Of an orientation, which has more noise per motion: without delay, filters with the same acceleration are closer."""
LATENCY_RATE = 0.25
"""Change of the delay per second, by which the motion is slower or faster during the change: a fraction of a second."""


class Latency(NamedTuple):
    """A delay that changes to ``goal_s`` at a constant rate."""

    value_s: float = 0.0
    """At ``time_ns``."""
    goal_s: float = 0.0
    """0 for a predictable target."""
    time_ns: int = 0

    def updated(self, unpredictability: float, delay_s: float, time_ns: int) -> Latency:
        """The same delay, from ``time_ns`` on changing to 0 or to ``delay_s``.

        Args:
            unpredictability: Of the target, see :class:`PredictorBank`.
            delay_s: Delay for an unpredictable target.
            time_ns: Time of the newest sample.
        """
        limit = UNPREDICTABLE if self.goal_s == 0.0 else PREDICTABLE
        return Latency(latency_at(self, time_ns)[0], delay_s if unpredictability > limit else 0.0, time_ns)


@compiled
def latency_at(latency: Latency, time_ns: int) -> tuple[float, float]:
    """Delay [s] and its rate of change at ``time_ns``."""
    left = latency.goal_s - latency.value_s
    # a late control step asks for times before the newest sample
    change = LATENCY_RATE * max(0, time_ns - latency.time_ns) / NS
    if abs(left) <= change:
        return latency.goal_s, 0.0
    return (latency.value_s + change, LATENCY_RATE) if left > 0.0 else (latency.value_s - change, -LATENCY_RATE)

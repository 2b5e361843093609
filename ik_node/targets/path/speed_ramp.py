"""Speed ramps at the begin and end of a path that does not rest there."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.math.numerics import smoothstep


class SpeedRamp(NamedTuple):
    """Maps the time since the start to the time on the path; plain data."""

    entry_s: float = 0.0
    """Time on the path at the start."""
    end_s: float = 0.0
    """Time on the path at the end."""
    rise_s: float = 0.0
    """Duration of acceleration; the speed rises as 3 u^2 - 2 u^3."""
    fall_s: float = 0.0
    """Duration of deceleration."""

    @property
    def duration_s(self) -> float:
        """Total duration."""
        return self.end_s - self.entry_s + 0.5 * (self.rise_s + self.fall_s)

    def time_s(self, clock_s: float) -> float:
        """Time on the path, ``entry_s`` to ``end_s``."""
        left_s = self.duration_s - clock_s
        if left_s <= 0.0:
            return self.end_s
        if clock_s < self.rise_s:
            return self.entry_s + _gone(clock_s, self.rise_s)
        if left_s < self.fall_s:
            return self.end_s - _gone(left_s, self.fall_s)
        return self.entry_s + clock_s - 0.5 * self.rise_s

    def time_rate(self, clock_s: float) -> tuple[float, float]:
        """Derivative of :meth:`time_s` and its derivative [1/s]."""
        left_s = self.duration_s - clock_s
        if left_s <= 0.0:
            return 0.0, 0.0
        for ramp_s, gone_s, sign in ((self.rise_s, clock_s, 1.0), (self.fall_s, left_s, -1.0)):
            if gone_s < ramp_s:
                u = gone_s / ramp_s
                return smoothstep(u), sign * 6.0 * u * (1.0 - u) / ramp_s
        return 1.0, 0.0


def _gone(time_s: float, ramp_s: float) -> float:
    """Time on the path gained in ``time_s`` of an acceleration that takes ``ramp_s``."""
    u = time_s / ramp_s
    return ramp_s * u**3 * (1.0 - 0.5 * u)

"""Timing of the control steps: which joint states make a step, and the mean interval between joint states."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS

INTERVAL_SMOOTHING = 0.02
"""Weight of the newest interval in the running mean."""
MIN_RATE_FRACTION = 0.3
"""Joint states slower than this fraction of ``rate_hz`` are a fault."""


class TimerSnapshot(NamedTuple):
    """Attributes of a :class:`StepTimer`."""

    interval_s: float
    due_ns: int


class StepTimer:
    """Limits the mean rate of the control steps, and measures the rate of the joint states."""

    def __init__(self, rate_hz: float) -> None:
        """``rate_hz``: largest mean rate of the control steps."""
        self.period_s = 1.0 / rate_hz
        self.period_ns = round(self.period_s * NS)
        self.interval_s = self.period_s
        """Running mean of the interval between control steps, s."""
        self._due_ns = 0

    def is_due(self, time_ns: int) -> bool:
        """True when the joint state of a monotonic time makes a control step; keeps the mean rate below rate_hz."""
        period_ns = self.period_ns
        if time_ns < self._due_ns - period_ns // 4:
            return False
        self._due_ns = max(self._due_ns, time_ns - period_ns) + period_ns
        return True

    def add_interval(self, interval_s: float) -> None:
        """Adds the time between two control steps to the running mean."""
        self.interval_s += INTERVAL_SMOOTHING * (interval_s - self.interval_s)

    def reset_interval(self) -> None:
        """Sets the running mean to the nominal period."""
        self.interval_s = self.period_s

    @property
    def too_slow(self) -> str:
        """Status text when the joint states are too slow; empty when they are fast enough."""
        slowest_s = self.period_s / MIN_RATE_FRACTION
        if self.interval_s > slowest_s:
            return f"joint states slower than {1.0 / slowest_s:.0f} Hz, {MIN_RATE_FRACTION:g} of rate_hz"
        return ""

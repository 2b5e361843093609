"""Rates of joint states, control steps and clock calls for the diagnostics, from the counts of the controller."""

from __future__ import annotations

from collections.abc import Mapping

from ik_node.control.step_timer import MIN_RATE_FRACTION, SAME_FRACTION
from ik_node.interfaces.clock import NS
from ik_node.interfaces.delivery import CLOCK_PERIOD_S

RATES = ("joint_states", "steps", "clock_calls")
"""Counts that are published per second; the others are published as they are."""


IN_TIME_HZ = 0.9 / CLOCK_PERIOD_S
"""From this rate of clock calls on the machine keeps up; otherwise DDS may have dropped joint states."""
STEADY_CALLS = 3
"""Consecutive calls that must find the same rate before it is reported."""


class StepRates:
    """Compares counts with those of the last call, and the rate of the joint states with ``rate_hz``."""

    def __init__(self) -> None:
        self._last: Mapping[str, int] = {}
        self._last_ns = 0
        self._candidate_hz = self._reported_hz = 0.0
        self._candidates = 0

    def values(self, counts: Mapping[str, int], now_ns: int) -> dict[str, str]:
        """Key-value pairs for the diagnostics.

        Args:
            counts: :attr:`ik_node.control.controller.Controller.counts`; joint states that were skipped are included.
            now_ns: Monotonic time.

        Returns:
            The counts as text; those of :data:`RATES` per second since the last call, with the key ``..._hz``. Without
            a last call, or when the controller is a new one, rates are missing.
        """
        elapsed_s, last = (now_ns - self._last_ns) / NS, self._last
        self._last, self._last_ns = dict(counts), now_ns
        is_known = bool(last) and elapsed_s > 0.0 and all(counts[name] >= last[name] for name in RATES)
        rates = {f"{name}_hz": f"{(counts[name] - last[name]) / elapsed_s:.0f}" for name in RATES if is_known}
        return rates | {name: str(count) for name, count in counts.items() if name not in RATES}

    def mismatch(self, rates: Mapping[str, str], rate_hz: float) -> str:
        """One line when the driver publishes joint states at a steady rate other than ``rate_hz``.

        Args:
            rates: Result of :meth:`values`, once per second.
            rate_hz: Highest rate of control steps.

        Returns:
            The text once for each such rate; empty otherwise, and while the machine does not keep up.
        """
        hz, clock_hz = (float(rates.get(f"{name}_hz", "0")) for name in ("joint_states", "clock_calls"))
        if hz <= 0.0 or clock_hz < IN_TIME_HZ:
            self._candidates = 0
            return ""
        self._candidates = self._candidates + 1 if _same(hz, self._candidate_hz) else 1
        self._candidate_hz = hz
        if self._candidates < STEADY_CALLS or _same(hz, self._reported_hz):
            return ""
        self._reported_hz = 0.0 if _same(hz, rate_hz) else hz
        if not self._reported_hz:
            return ""
        effect = "not every one makes a control step"
        if hz < rate_hz:
            expected_hz = float(rates.get("expected_hz", rate_hz))
            follows = _same(hz, expected_hz)
            effect = (
                "control follows them" if follows else f"the arm stops below {MIN_RATE_FRACTION:g} of {expected_hz:g}"
            )
        return f"joint states arrive at {hz:.0f} Hz, rate_hz is {rate_hz:g}: {effect}"


def _same(first_hz: float, second_hz: float) -> bool:
    return abs(first_hz - second_hz) <= SAME_FRACTION * max(first_hz, second_hz)

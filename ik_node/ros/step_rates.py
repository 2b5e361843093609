"""Rates of joint states, control steps and clock calls for the diagnostics, from the counts of the controller."""

from __future__ import annotations

from collections.abc import Mapping

from ik_node.interfaces.clock import NS

RATES = ("joint_states", "steps", "clock_calls")
"""Counts that are published per second; the others are published as they are."""


class StepRates:
    """Compares counts with those of the last call."""

    def __init__(self) -> None:
        self._last: Mapping[str, int] = {}
        self._last_ns = 0

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

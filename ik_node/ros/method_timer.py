"""Computing time of own methods: measured at configuration, and in every control step."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from statistics import median
from time import perf_counter_ns
from typing import Any

import numpy as np

from ik_node.differential_ik.own_methods import MethodFunction, OwnMethod, load_methods
from ik_node.errors import MethodFault
from ik_node.interfaces.clock import NS
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import finite_range
from ik_node.settings.groups import Settings

MAX_FRACTION = 0.5
"""Largest fraction of the control period that a call may take; the rest of a control step needs the other half."""
MAX_CALL_S = 0.05
"""Longest time of a single call, s; half of the default ``state.timeout_s``, after which the arm is stopped."""
CALLS = 21
"""Number of the last calls whose median counts: single calls are held up by other processes."""


class MethodTimer:
    """Loads the own methods of a node and measures their calls."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        """Raises SettingsError when a method cannot be loaded."""
        self._robot, self._period_ns = robot, NS / settings.control.rate_hz
        self._measured: dict[str, deque[int]] = {}
        loaded = load_methods(robot, settings.control)
        self.methods: Mapping[str, OwnMethod] = {
            name: method._replace(function=self._timed(name, method.function)) for name, method in loaded.items()
        }
        """For the controller."""

    def _timed(self, name: str, function: MethodFunction) -> MethodFunction:
        measured = self._measured[name] = deque(maxlen=CALLS)

        def call(robot: Robot, q: Array) -> Any:
            begin_ns = perf_counter_ns()
            try:
                return function(robot, q)
            finally:
                measured.append(perf_counter_ns() - begin_ns)

        return call

    def reports(self) -> Iterator[str]:
        """Measures each method and yields a line with its time per call, compared with the control period."""
        low, high = finite_range(self._robot)
        points = low + (high - low) * low_discrepancy_points(np.arange(CALLS), self._robot.n)
        robot = self._robot.copy()
        for name, method in self.methods.items():
            try:
                for q in points:
                    method.cost(robot, q)
            except MethodFault as fault:
                yield str(fault)
            yield self._text(name)

    def slow(self, name: str) -> str:
        """Why the method ``name`` has to be replaced; empty if it is fast enough, or built in."""
        measured = self._measured.get(name)
        if measured is None or len(measured) == 0:
            return ""
        text = ""
        if measured[-1] > MAX_CALL_S * NS:
            text = f"method '{name}': a call took {measured[-1] / NS:.2f} s, more than {MAX_CALL_S:g} s"
        elif len(measured) == CALLS and median(measured) > MAX_FRACTION * self._period_ns:
            text = f"{self._text(name)}, more than {100.0 * MAX_FRACTION:.0f} %"
        if text:
            measured.clear()  # when it is selected again, it is measured again
        return text

    def _text(self, name: str) -> str:
        time_ns = median(self._measured[name])
        return (
            f"method '{name}': {1e-6 * time_ns:.3f} ms per call, {100.0 * time_ns / self._period_ns:.0f} % of a period"
        )

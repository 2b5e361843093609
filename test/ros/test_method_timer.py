"""The computing time of own methods in the node: said at the start, and one that is too slow is replaced by plain."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")

from loop import make_robot

from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.ros.method_timer import CALLS, MAX_CALL_S, MethodTimer
from ik_node.settings.groups import Settings

SPENT_S = 0.0


def spending(robot: Robot, q: Array) -> Any:
    """Computes for ``SPENT_S`` at least."""
    end_s = perf_counter() + SPENT_S
    while perf_counter() < end_s:
        pass
    return None, np.zeros(robot.n)


NAME = f"{__name__}:spending"


def timer(rate_hz: float) -> MethodTimer:
    return MethodTimer(make_robot("ur5"), Settings().with_values({"method": NAME, "rate_hz": rate_hz}))


def spend(monkeypatch: pytest.MonkeyPatch, time_s: float) -> None:
    monkeypatch.setattr("test_method_timer.SPENT_S", time_s)


def test_the_time_per_call_is_compared_with_the_period(monkeypatch: pytest.MonkeyPatch) -> None:
    spend(monkeypatch, 0.006)
    one = timer(100.0)
    (line,) = one.reports()
    assert line.startswith(f"method '{NAME}': ")
    time_ms, percent = float(line.split()[2]), float(line.split()[6])
    assert time_ms >= 6.0
    assert percent == pytest.approx(10.0 * time_ms, abs=1.0)
    assert "more than 50 %" in one.slow(NAME)
    assert one.slow(NAME) == "", "measured again from here on"
    assert one.slow("plain") == ""


def test_a_method_is_slow_when_most_of_the_last_calls_are(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, q = make_robot("ur5"), np.zeros(6)
    one = timer(10.0)
    method = one.methods[NAME]
    for _ in range(CALLS):
        method.cost(robot, q)
    assert one.slow(NAME) == ""
    spend(monkeypatch, 1.2 * MAX_CALL_S)
    method.cost(robot, q)
    assert f"more than {MAX_CALL_S:g} s" in one.slow(NAME), "a single call that holds up the commands"


def test_without_own_methods_nothing_is_measured() -> None:
    one = MethodTimer(make_robot("ur5"), Settings())
    assert list(one.reports()) == []
    assert one.slow("plain") == ""

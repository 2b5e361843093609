"""The node names the rate of the joint states and ``rate_hz`` when they differ."""

from __future__ import annotations

import pytest

from ik_node.interfaces.clock import NS
from ik_node.ros.step_rates import StepRates

SLOW = "joint states arrive at 125 Hz, rate_hz is 500: control follows them"
SLOWER = "joint states arrive at 125 Hz, rate_hz is 500: the arm stops below 0.3 of 500"
FAST = "joint states arrive at 1000 Hz, rate_hz is 500: not every one makes a control step"


class Seconds:
    """Counts of a node, second by second."""

    def __init__(self) -> None:
        self.rates = StepRates()
        self.counts = {"joint_states": 0, "steps": 0, "clock_calls": 0}
        self.time_ns = NS

    def texts(self, number: int, joint_states: int, clock_calls: int = 100, expected_hz: int = 125) -> list[str]:
        """What is reported in ``number`` seconds."""
        self.counts["expected_hz"] = expected_hz
        found = []
        for _ in range(number):
            self.time_ns += NS
            self.counts["joint_states"] += joint_states
            self.counts["clock_calls"] += clock_calls
            found.append(self.rates.mismatch(self.rates.values(self.counts, self.time_ns), 500.0))
        return [text for text in found if text]


@pytest.mark.parametrize(("hz", "text"), [(125, SLOW), (1000, FAST)])
def test_another_rate_is_reported_once(hz: int, text: str) -> None:
    seconds = Seconds()
    assert seconds.texts(20, hz) == [text]
    assert seconds.texts(5, 500) == []
    assert seconds.texts(20, hz) == [text]


def test_a_driver_that_became_slower_is_told_when_the_arm_stops() -> None:
    assert Seconds().texts(20, 125, expected_hz=500) == [SLOWER]


def test_the_same_rate_is_not_reported() -> None:
    seconds = Seconds()
    assert [text for hz in (500, 480, 520, 470) for text in seconds.texts(4, hz)] == []


def test_a_machine_that_does_not_keep_up_and_a_rate_that_changes_are_not_reported() -> None:
    seconds = Seconds()
    assert seconds.texts(20, 125, clock_calls=60) == []
    assert [text for hz in (100, 200, 300) * 5 for text in seconds.texts(1, hz)] == []

"""Too few control steps: slow joint states and a machine that does not keep up are told apart, and stop the arm once.

A machine that does not keep up makes its calls late; here their times are chosen. test/ros/test_node_overload.py runs
over DDS.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.step_timer import RECOVERY_S
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level, Mode
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

RATE_HZ = 500.0
DRIVER = "joint states arrive slower than 150 Hz, 0.3 of rate_hz; continues after 2 s above 250 Hz"
MACHINE = "this machine makes fewer than 150 control steps per second, 0.3 of rate_hz; continues after 2 s above 250 Hz"


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


class Clocked(Loop):
    """A loop that also makes the clock calls and sends targets; the driver publishes at ``rate_hz``.

    While ``asleep_s`` > 0 the process works for ``awake_s`` and is then held up for ``asleep_s``. Afterwards it finds
    the ten newest joint states that have queued up, as DDS delivers them.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, READY["panda"], Settings())
        self.rate_hz = RATE_HZ
        self.awake_s = self.asleep_s = 0.0
        self.modes: list[Mode] = []
        self.reasons: list[str] = []
        self._driver_ns = self._clock_ns = self._awake_ns = self.time_ns
        self._figure = figure_of_eight(self.pose())
        self._begin_ns = self.time_ns

    def pass_time(self, duration_s: float) -> None:
        end_ns = self.time_ns + round(duration_s * NS)
        while self.time_ns < end_ns:
            self.time_ns += NS // 1000
            if self.asleep_s and self.time_ns - self._awake_ns > self.awake_s * NS:
                self.time_ns += round(self.asleep_s * NS)
                self._awake_ns = self.time_ns
            elif not self.asleep_s:
                self._awake_ns = self.time_ns
            self._states()
            if self.time_ns >= self._clock_ns:
                self.take(self.controller.on_clock(self.now))
                self._clock_ns = self.time_ns + NS // 100
                self.target(self._figure.pose((self.time_ns - self._begin_ns) / NS))
            if not self.modes or self.modes[-1] is not self.mode():
                self.modes.append(self.mode())
                self.reasons.append(self.controller.status.reason)

    def _states(self) -> None:
        period_ns = round(NS / self.rate_hz)
        due = range(self._driver_ns, self.time_ns + 1, period_ns)
        for stamp_ns in due[-10:]:
            age_ns = self.time_ns - stamp_ns
            sample = JointSample(self.now.ros_ns - age_ns, self.robot.joints, self.position)
            self.take(self.controller.on_joint_state(sample, self.now))
        self._driver_ns += len(due) * period_ns

    @property
    def stops(self) -> int:
        return self.modes.count(Mode.STOPPED)


@pytest.fixture
def moving(panda: Robot) -> Clocked:
    loop = Clocked(panda)
    loop.pass_time(1.5)
    assert np.abs(loop.steps[-1].joint_velocity).max() > 0.05
    assert loop.stops == 0
    return loop


def test_slow_joint_states_name_the_driver(moving: Clocked) -> None:
    moving.rate_hz = 100.0
    moving.pass_time(5.0)
    assert (moving.stops, moving.mode()) == (1, Mode.STOPPED)
    assert moving.controller.status.reason == DRIVER
    assert moving.controller.status.level is Level.ERROR
    moving.rate_hz = RATE_HZ
    moving.pass_time(RECOVERY_S + 1.0)
    assert moving.mode() is Mode.TRACKING


def test_late_control_steps_name_the_machine(moving: Clocked) -> None:
    """Ten of 45 joint states are processed every 90 ms: 111 per second."""
    moving.awake_s, moving.asleep_s = 0.001, 0.09
    moving.pass_time(5.0)
    assert (moving.stops, moving.mode()) == (1, Mode.STOPPED)
    assert moving.controller.status.reason == MACHINE
    moving.asleep_s = 0.0
    moving.pass_time(RECOVERY_S + 1.0)
    assert moving.mode() is Mode.TRACKING


def test_above_the_floor_the_arm_moves_on_within_its_limits(moving: Clocked) -> None:
    """Fewer steps than ``rate_hz``: the arm is not stopped, the status names the machine, the commands keep the
    acceleration limits over the time that passed."""
    moving.awake_s, moving.asleep_s = 0.02, 0.05
    first = len(moving.steps)
    moving.pass_time(5.0)
    assert moving.stops == 0
    assert "this machine makes fewer than 350 control steps per second" in moving.controller.status.reason
    assert moving.controller.status.level is Level.WARN
    steps = moving.steps[first - 1 :]
    velocity = np.array([step.joint_velocity for step in steps])
    elapsed_s = np.diff([step.now.monotonic_ns for step in steps]) / NS
    acceleration = np.array(moving.settings.limits.acceleration)
    allowed = np.maximum(elapsed_s, 1.0 / RATE_HZ)[:, None] * acceleration
    assert (np.abs(np.diff(velocity, axis=0)) <= allowed * (1.0 + 1e-9)).all()
    moving.asleep_s = 0.0
    moving.pass_time(2.0)
    assert "this machine" not in moving.controller.status.reason


@pytest.mark.parametrize(("low", "high"), [(0.2, 0.45), (0.28, 0.32), (0.25, 1.0)])
def test_a_rate_around_the_floor_stops_the_arm_once(moving: Clocked, low: float, high: float) -> None:
    for _ in range(20):
        for fraction in (low, high):
            moving.rate_hz = fraction * RATE_HZ
            moving.pass_time(1.5)
    assert moving.stops == 1


def test_a_machine_that_fails_after_each_restart_is_tried_ever_less_often(moving: Clocked) -> None:
    """A stopped arm needs less computing time: the rate is high while it is stopped, and low when it moves."""
    for _ in range(600):
        moving.rate_hz = 100.0 if moving.mode() is Mode.TRACKING else RATE_HZ
        moving.pass_time(0.1)
    assert 4 <= moving.stops <= 6
    assert "continues after 16 s" in moving.reasons[-1]


FAULTS: dict[str, Callable[[Clocked, bool], None]] = {
    "held up": lambda loop, on: setattr(loop, "asleep_s", 0.3 if on else 0.0),
    "driver silent": lambda loop, on: setattr(loop, "rate_hz", 4.0 if on else RATE_HZ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_silences_that_repeat_do_not_stop_and_start_the_arm_each_time(moving: Clocked, fault: str) -> None:
    """Before, the arm started after each of 20 silences."""
    moving.awake_s = 0.1
    for _ in range(20):
        FAULTS[fault](moving, True)
        moving.pass_time(0.3)
        FAULTS[fault](moving, False)
        moving.pass_time(0.2)
    assert 1 <= moving.stops <= 5
    assert any("repeated, continues after 2 s" in reason for reason in moving.reasons)
    moving.pass_time(20.0)
    assert moving.mode() is Mode.TRACKING


def test_a_stop_during_the_delay_of_repeated_stops_names_that_delay(moving: Clocked) -> None:
    """Before, the arm stood for seconds with a reason that had passed."""
    moving.awake_s = 0.1
    for _ in range(2):
        FAULTS["driver silent"](moving, True)
        moving.pass_time(0.3)
        FAULTS["driver silent"](moving, False)
        moving.pass_time(0.2)
    assert moving.mode() is Mode.STOPPED
    broken = JointSample(moving.now.ros_ns, moving.robot.joints, np.full(moving.robot.n, np.nan))
    moving.take(moving.controller.on_joint_state(broken, moving.now))
    status = moving.controller.status
    assert "not finite" in status.reason
    assert "; repeated, continues after " in status.reason


def test_after_a_single_silence_the_arm_starts_at_once(moving: Clocked) -> None:
    moving.rate_hz = 1.0
    moving.pass_time(1.0)
    assert moving.mode() is Mode.STOPPED
    moving.rate_hz = RATE_HZ
    moving.pass_time(0.1)
    assert moving.mode() in (Mode.HOLDING, Mode.TRACKING)


def test_the_counts_tell_arrived_made_and_late_apart(moving: Clocked) -> None:
    before = moving.controller.counts
    moving.rate_hz = 1000.0
    moving.pass_time(1.0)
    fast = moving.controller.counts
    moving.awake_s, moving.asleep_s = 0.001, 0.02
    moving.pass_time(1.0)
    after = moving.controller.counts
    assert fast["joint_states"] - before["joint_states"] == pytest.approx(1000, abs=5)
    assert fast["steps"] - before["steps"] == pytest.approx(500, abs=5)
    assert fast["steps_late"] == before["steps_late"]
    assert fast["clock_calls"] - before["clock_calls"] == pytest.approx(100, abs=2)
    assert after["steps_late"] - fast["steps_late"] == pytest.approx(1.0 / 0.022, abs=3)
    assert after["clock_calls"] - fast["clock_calls"] < 60

"""The rate of control follows the joint states: a driver at another rate than ``rate_hz`` is no fault.

test/ros/test_followed_rate_dds.py runs over DDS. A driver that becomes slower later is tested in test_overload.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from loop import READY, Loop, make_robot
from made_steps import same_bits
from recorded_loop import finish, recorded_loop

from ik_node.control.step_timer import MEASURED_S, StepTimer
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level, Mode
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.report import compute_metrics
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def driven(loop: Loop, driver_hz: float, duration_s: float) -> None:
    """Runs a loop with a driver at its own rate, with clock calls at 100 Hz, on a figure of eight."""
    period_ns, begin_ns = round(NS / driver_hz), loop.time_ns
    shape = figure_of_eight(loop.pose())
    end_ns, state_ns, clock_ns, target_ns = begin_ns + round(duration_s * NS), begin_ns, begin_ns, begin_ns
    while loop.time_ns < end_ns:
        loop.time_ns = min(state_ns, clock_ns, target_ns)
        if loop.time_ns == state_ns:
            sample = JointSample(loop.now.ros_ns, loop.robot.joints, loop.position)
            loop.take(loop.controller.on_joint_state(sample, loop.now))
            state_ns += period_ns
        if loop.time_ns == clock_ns:
            loop.take(loop.controller.on_clock(loop.now))
            clock_ns += NS // 100
        if loop.time_ns == target_ns:
            loop.target(shape.pose((loop.time_ns - begin_ns) / NS))
            target_ns += NS // 50


def acceleration_used(loop: Loop) -> Array:
    velocity = np.array([step.joint_velocity for step in loop.steps])
    times = np.array([step.now.monotonic_ns for step in loop.steps]) / NS
    limit = np.array(loop.settings.limits.acceleration)
    return np.asarray(np.abs(np.diff(velocity, axis=0) / np.diff(times)[:, None]) / limit)


@pytest.mark.parametrize("driver_hz", [30.0, 100.0, 125.0, 150.0, 333.0, 500.0])
def test_an_arm_moves_at_the_rate_of_its_driver(panda: Robot, driver_hz: float) -> None:
    loop = Loop(panda, READY["panda"], Settings())
    driven(loop, driver_hz, 5.0)
    assert loop.mode() is Mode.TRACKING
    assert loop.controller.status.level is Level.OK, loop.controller.status.reason
    assert all(step.status.mode in (Mode.HOLDING, Mode.TRACKING) for step in loop.steps)
    assert len(loop.steps) == pytest.approx(5.0 * driver_hz, abs=3)
    assert loop.controller.counts["expected_hz"] == pytest.approx(driver_hz, rel=0.05)
    error = np.linalg.norm(loop.steps[-1].pose_sb[:3, 3] - loop.steps[-1].pose_sd[:3, 3])
    assert error < 2e-3
    assert acceleration_used(loop).max() <= 1.0 + 1e-9


def test_a_faster_driver_makes_steps_at_rate_hz(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"], Settings().with_values({"rate_hz": 200.0}))
    driven(loop, 1000.0, 2.0)
    assert loop.controller.counts["expected_hz"] == 200
    assert len(loop.steps) == pytest.approx(400, abs=3)


def test_no_command_is_reported_as_held_too_long_at_the_rate_of_the_driver(panda: Robot) -> None:
    """At 90 Hz each command is held for longer than five periods of 500 Hz."""
    loop = Loop(panda, READY["panda"], Settings())
    driven(loop, 90.0, 3.0)
    after = [step for step in loop.steps if step.now.monotonic_ns > NS + 1.5 * MEASURED_S * NS]
    assert not any("held for longer" in step.status.reason for step in after)
    assert loop.controller.counts["steps_late"] <= MEASURED_S * 90.0 + 1.0


def test_a_slow_driver_that_stops_half_way_is_a_fault(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"], Settings().with_values({"state.timeout_s": 1.0}))
    driven(loop, 125.0, 2.0)
    driven(loop, 25.0, 3.0)
    assert loop.mode() is Mode.STOPPED
    assert "slower than 38 Hz, 0.3 of the 125 Hz at which they came" in loop.controller.status.reason


def test_a_driver_that_comes_back_at_another_rate_is_followed(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"], Settings())
    for driver_hz in (500.0, 100.0, 500.0):
        driven(loop, driver_hz, 2.0)
        assert loop.controller.counts["expected_hz"] == pytest.approx(driver_hz, rel=0.05)
        loop.time_ns += NS
        loop.take(loop.controller.on_clock(loop.now))
        assert loop.mode() is Mode.STOPPED
    driven(loop, 100.0, 3.0)


def test_a_rate_that_rises_is_followed_up_to_rate_hz() -> None:
    timer, time_ns = StepTimer(500.0), NS
    for hz, seconds, expected in ((100.0, 1.0, 100.0), (250.0, 3.0, 250.0), (900.0, 3.0, 500.0)):
        for _ in range(round(hz * seconds)):
            time_ns += round(NS / hz)
            timer.is_due(time_ns, time_ns)
        assert timer.expected_hz == pytest.approx(expected, rel=0.1)


def test_a_machine_that_does_not_keep_up_is_not_taken_for_the_driver() -> None:
    """Clock calls at a third of their rate: the joint states that are left say nothing about the driver."""
    timer, time_ns = StepTimer(500.0), NS
    for index in range(300):
        time_ns += NS // 100
        timer.is_due(time_ns, time_ns)
        if index % 3 == 0:
            timer.add_clock_call(time_ns)
    assert timer.expected_hz == 500.0
    assert "this machine" in timer.too_slow


def test_a_replay_has_the_same_rate(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 500.0})
    driven(loop, 100.0, 2.0)
    finish(loop)
    assert replay(RecordingSource(tmp_path / "bag")).first is None
    run = load_run(tmp_path / "bag")
    metrics = compute_metrics(run)
    assert metrics.late_steps.late < MEASURED_S * 100.0, "late are steps beyond two periods of the driver"


def test_a_controller_from_a_snapshot_has_the_same_rate(panda: Robot) -> None:
    first = Loop(panda, READY["panda"], Settings())
    driven(first, 100.0, 2.0)
    second = Loop(panda, first.position, first.settings)
    second.controller.restore(first.controller.capture())
    second.time_ns, before = first.time_ns, len(first.steps)
    for loop in (first, second):
        loop.arm = SimulatedArm(second.position, panda.limits, loop.time_ns)
        loop.arm.command(first.steps[before - 1].joint_velocity, loop.time_ns)
        driven(loop, 100.0, 0.5)
    assert len(second.steps) > 40
    assert same_bits(tuple(second.steps), tuple(first.steps[before:]))

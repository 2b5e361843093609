"""A process that is held up (SIGSTOP, a suspended or starved machine) continues with zero velocity.

The gap is in the times of the calls, so these tests need no process. Over DDS: test/ros/test_watchdog.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level, Mode, Step
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

HELD_UP_S = (0.2, 1.0, 60.0)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def moving_loop(robot: Robot) -> Loop:
    """An arm in the middle of a figure of eight."""
    loop = Loop(robot, READY["panda"], Settings())
    loop.run(0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, 3.0, 100.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() > 0.05
    return loop


def queued_joint_state(loop: Loop, before_s: float) -> Step | None:
    """A joint state from before the hold-up that was waiting in DDS."""
    stamp_ns = loop.now.ros_ns - round(before_s * NS)
    sample = JointSample(stamp_ns, loop.robot.joints, loop.steps[-1].joint_position)
    return loop.controller.on_joint_state(sample, loop.now)


FIRST_CALLS: dict[str, Callable[[Loop, float], Step | None]] = {
    "clock": lambda loop, _: loop.controller.on_clock(loop.now),
    "queued joint state": queued_joint_state,
    "new joint state": lambda loop, _: queued_joint_state(loop, 0.0),
    "foreign joint state": lambda loop, _: loop.controller.on_joint_state(
        JointSample(0, ("finger",), np.zeros(1)), loop.now
    ),
    "pause": lambda loop, _: loop.controller.pause(loop.now, "the process is ending"),
    "no subscriber": lambda loop, _: loop.controller.on_listeners(0, loop.now),
}


@pytest.mark.parametrize("held_up_s", HELD_UP_S)
@pytest.mark.parametrize("first_call", FIRST_CALLS)
def test_the_first_command_after_a_hold_up_is_zero(panda: Robot, first_call: str, held_up_s: float) -> None:
    loop = moving_loop(panda)
    loop.time_ns += round(held_up_s * NS)
    step = FIRST_CALLS[first_call](loop, held_up_s)
    assert step is not None
    assert not step.joint_velocity.any()
    assert step.status.level is Level.ERROR
    assert step.status.reason.startswith(f"the node was held up for {held_up_s:.2f} s")
    assert loop.controller.at_rest
    assert loop.controller.on_clock(loop.now) is None


@pytest.mark.parametrize("held_up_s", HELD_UP_S)
def test_a_hold_up_within_a_ramp_ends_it_with_zero(panda: Robot, held_up_s: float) -> None:
    loop = moving_loop(panda)
    loop.controller.apply(loop.settings.with_values({"limits.acceleration": [0.001]}))
    loop.controller.pause(loop.now)
    assert loop.mode() is Mode.RAMPING
    loop.run(0.02)
    assert loop.steps[-1].joint_velocity.any()
    loop.time_ns += round(held_up_s * NS)
    step = loop.controller.on_clock(loop.now)
    assert step is not None
    assert not step.joint_velocity.any()
    assert loop.mode() is Mode.PAUSED


def test_control_continues_from_a_position_measured_after_the_hold_up(panda: Robot) -> None:
    """The positions that have queued up are old: the arm was moved by another commander meanwhile."""
    loop = moving_loop(panda)
    old = loop.position
    loop.time_ns += NS
    loop.arm.command(np.full(panda.n, 0.1), loop.time_ns)
    loop.time_ns += NS
    loop.arm.command(np.zeros(panda.n), loop.time_ns)
    for index in range(20):
        loop.time_ns += 100_000
        sample = JointSample(loop.now.ros_ns - 2 * NS + index * loop.period_ns, panda.joints, old)
        step = loop.controller.on_joint_state(sample, loop.now)
        assert step is None or not step.joint_velocity.any()
    count = len(loop.steps)
    loop.run(0.5)
    assert loop.mode() is Mode.HOLDING
    assert len(loop.steps) > count
    assert max(np.abs(step.joint_velocity).max() for step in loop.steps[count:]) < 1e-6


def test_a_short_gap_between_joint_states_is_no_hold_up(panda: Robot) -> None:
    loop = moving_loop(panda)
    loop.time_ns += round(0.09 * NS)
    step = queued_joint_state(loop, 0.0)
    assert step is not None
    assert loop.mode() in (Mode.TRACKING, Mode.RAMPING)

"""Limits that change while the arm moves, and the first command after a stop: each change keeps the limits in force.

Judged by the commands alone: between two commands a joint changes by no more than its acceleration limit allows, and a
command over a velocity limit is one that was lowered, and decreases at the acceleration limit.
"""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.errors import SettingsError
from ik_node.interfaces.step import Level, Mode
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

ACCELERATION = 10.0


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def moving_loop(robot: Robot, **values: object) -> Loop:
    """A loop in the middle of a fast figure of eight."""
    settings = Settings().with_values({name.replace("__", "."): value for name, value in values.items()})
    loop = Loop(robot, READY["panda"], settings)
    loop.run(0.05)
    follow(loop, 3.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() > 0.3
    return loop


def follow(loop: Loop, duration_s: float) -> None:
    shape = figure_of_eight(loop.pose(), period_s=2.0)
    loop.follow(shape.pose, duration_s, 100.0)


def apply(loop: Loop, **values: object) -> None:
    loop.settings = loop.settings.with_values({name.replace("__", "."): value for name, value in values.items()})
    loop.controller.check(loop.settings)
    loop.controller.apply(loop.settings)


def assert_reduced_within(loop: Loop, begun: int, limit: Array, acceleration: float = ACCELERATION) -> int:
    """Checks all commands from ``begun`` on; returns the number of those over the limit."""
    dt = loop.period_ns * 1e-9
    velocities = np.array([step.joint_velocity for step in loop.steps[begun - 1 :]])
    changes = np.abs(np.diff(velocities, axis=0))
    assert changes.max() <= acceleration * dt + 1e-9
    over = np.abs(velocities) > limit + 1e-9
    falling = np.abs(velocities[:-1]) - np.abs(velocities[1:])
    assert (falling[over[1:]] >= acceleration * dt - 1e-9).all(), "over the limit it decreases as fast as it may"
    return int(over[1:].any(axis=1).sum())


@pytest.mark.parametrize("control_law", ["twist_feedback", "ik_difference"])
def test_a_velocity_limit_that_is_lowered_while_moving_is_reached_within_the_acceleration_limit(
    panda: Robot, control_law: str
) -> None:
    loop = moving_loop(panda, control_law=control_law)
    begun = len(loop.steps)
    apply(loop, limits__velocity_fraction=0.02)
    loop.run(0.02)
    assert "a velocity limit was lowered" in loop.controller.status.reason
    assert loop.controller.status.level is Level.WARN
    loop.run(1.0)
    assert assert_reduced_within(loop, begun, 0.02 * panda.limits.velocity) > 5
    assert "was lowered" not in loop.controller.status.reason
    assert loop.mode() in (Mode.HOLDING, Mode.TRACKING)


@pytest.mark.parametrize("values", [{"limits__velocity_fraction": 0.02}, {"limits__velocity": (0.05,)}])
def test_the_ramp_of_a_pause_obeys_a_velocity_limit_that_is_lowered(panda: Robot, values: dict[str, object]) -> None:
    loop = moving_loop(panda)
    begun = len(loop.steps)
    loop.controller.pause(loop.now)
    loop.run(0.006)
    apply(loop, **values)
    loop.tick()
    assert loop.mode() is Mode.RAMPING
    loop.run(1.0)
    fraction = values.get("limits__velocity_fraction")
    limit = 0.02 * panda.limits.velocity if fraction else np.full(7, 0.05)
    assert assert_reduced_within(loop, begun + 4, limit) > 0
    assert loop.mode() is Mode.PAUSED
    assert not loop.steps[-1].joint_velocity.any()


@pytest.mark.parametrize("acceleration", [2.0, 30.0])
def test_the_ramp_of_a_pause_obeys_a_changed_acceleration_limit(panda: Robot, acceleration: float) -> None:
    loop = moving_loop(panda)
    loop.controller.pause(loop.now)
    loop.run(0.006)
    begun = len(loop.steps)
    apply(loop, limits__acceleration=(acceleration,))
    loop.run(2.0)
    velocities = np.array([step.joint_velocity for step in loop.steps[begun - 1 :]])
    changes = np.abs(np.diff(velocities, axis=0))
    assert changes.max() <= acceleration * 0.002 + 1e-9
    assert changes.max() >= acceleration * 0.002 - 1e-9
    assert loop.mode() is Mode.PAUSED


def test_a_ramp_that_begins_while_a_limit_is_reached_continues_to_reduce(panda: Robot) -> None:
    loop = moving_loop(panda)
    begun = len(loop.steps)
    apply(loop, limits__velocity_fraction=0.02)
    loop.run(0.004)
    loop.controller.pause(loop.now)
    loop.run(1.0)
    assert assert_reduced_within(loop, begun + 3, 0.02 * panda.limits.velocity) > 0
    assert loop.mode() is Mode.PAUSED


@pytest.mark.parametrize("after_ns", [100_000, 500_000, 1_900_000])
def test_the_first_command_after_a_stop_keeps_the_acceleration_limit(panda: Robot, after_ns: int) -> None:
    """The next joint state may arrive less than a period after the zeros. A joint outside its limit moves at once."""
    upper = panda.limits.upper.copy()
    upper[3] = READY["panda"][3] - 0.2
    loop = Loop(panda, READY["panda"], Settings().with_values({"limits.position_upper": upper.tolist()}))
    loop.run(0.5)
    assert loop.steps[-1].joint_velocity[3] == pytest.approx(-0.1)
    loop.time_ns += 110_000_000
    stop = loop.take(loop.controller.on_clock(loop.now))
    assert stop is not None
    assert not stop.joint_velocity.any()
    loop.time_ns += after_ns - loop.period_ns
    step = loop.tick()
    assert step is not None
    assert step.joint_velocity.any()
    assert np.abs(step.joint_velocity).max() <= ACCELERATION * after_ns * 1e-9 + 1e-12


@pytest.mark.parametrize("posture", [(1.0, 2.0, 3.0), (0.5, 0.5), tuple([0.1] * 8)])
def test_a_posture_of_another_length_is_refused(panda: Robot, posture: tuple[float, ...]) -> None:
    settings = Settings().with_values({"obstacles.posture": posture})
    expected = rf"obstacles.posture has {len(posture)} values; expected 1 or 7, in the order panda_joint1"
    with pytest.raises(SettingsError, match=expected):
        Loop(panda, READY["panda"], settings)
    loop = Loop(panda, READY["panda"])
    for call in (loop.controller.check, loop.controller.apply):
        with pytest.raises(SettingsError, match=expected):
            call(settings)
    assert loop.controller.settings == Settings()


def test_one_posture_for_all_joints_and_a_weight_without_posture(panda: Robot) -> None:
    loop = Loop(panda, READY["panda"], Settings().with_values({"obstacles.posture_weight": 1.0}))
    loop.run(0.1)
    assert "obstacles.posture is empty" in loop.controller.status.reason
    apply(loop, obstacles__posture=(0.5,))
    loop.run(1.0)
    one = loop.position
    assert "obstacles.posture" not in loop.controller.status.reason
    all_joints = Loop(panda, READY["panda"], Settings().with_values({"obstacles.posture_weight": 1.0}))
    all_joints.run(0.1)
    apply(all_joints, obstacles__posture=(0.5,) * 7)
    all_joints.run(1.0)
    assert np.array_equal(one, all_joints.position)
    assert np.abs(one - READY["panda"]).max() > 1e-4

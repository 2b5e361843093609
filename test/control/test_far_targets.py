"""Targets that are far away: refused beyond 100 m, and reported at once when the arm cannot reach them."""

from __future__ import annotations

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.errors import TargetRefused
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import PathSample, PoseSample, TrajectorySample
from ik_node.interfaces.step import Level
from ik_node.math.types import Array
from ik_node.robot.reach import reach_of
from ik_node.robot.robot import Robot

DOWN = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


@pytest.fixture
def loop(panda: Robot) -> Loop:
    made = Loop(panda, READY["panda"])
    made.run(0.05)
    return made


def beyond(robot: Robot, distance: float) -> Array:
    """A position ``distance`` m out of reach."""
    reach = reach_of(robot)
    return reach.centre_s + np.array([0.6, 0.0, 0.8]) * (reach.radius + distance)


def give(loop: Loop, position: Array) -> None:
    sample = PoseSample(0, loop.robot.base_frame, position, DOWN)
    loop.controller.on_target_pose(sample, loop.now)


@pytest.mark.parametrize("value", [101.0, 1e6, 1e154, 1e160, 1e308, -1e308])
def test_poses_of_a_stream_are_refused_beyond_the_bound_of_paths(loop: Loop, value: float) -> None:
    with pytest.raises(TargetRefused, match="target is more than 100 m away"):
        give(loop, np.array([0.5, value, 0.5]))
    loop.run(0.02)
    assert "target_pose refused: target is more than 100 m away" in loop.controller.status.reason
    assert loop.controller.status.level is Level.WARN
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-9


def test_a_pose_out_of_reach_is_reported_before_the_arm_has_stretched(loop: Loop) -> None:
    give(loop, beyond(loop.robot, 0.43))
    loop.tick()
    assert "target is 0.43 m out of reach" in loop.controller.status.reason
    assert loop.controller.status.level is Level.WARN
    for _ in range(50):
        give(loop, loop.pose()[:3, 3])
        loop.run(0.02)
    assert "out of reach" not in loop.controller.status.reason


def test_the_report_ends_with_the_target(loop: Loop) -> None:
    give(loop, beyond(loop.robot, 1.0))
    loop.tick()
    loop.controller.pause(loop.now)
    loop.run(0.5)
    assert "out of reach" not in loop.controller.status.reason
    loop.controller.resume()
    loop.run(0.05)
    assert "out of reach" not in loop.controller.status.reason


def test_the_farthest_pose_of_a_path_and_of_a_trajectory_is_named(loop: Loop) -> None:
    frame, start = loop.robot.base_frame, loop.pose()[:3, 3]
    positions = np.array([start, beyond(loop.robot, 0.2), beyond(loop.robot, 0.3), start])
    turns = np.tile(DOWN, (4, 1))
    loop.controller.on_target_path(PathSample((frame,) * 4, (0,) * 4, positions, turns), loop.now)
    loop.tick()
    assert "pose 2 of target_path is 0.30 m out of reach" in loop.controller.status.reason
    times = tuple(index * 2 * NS for index in range(4))
    none = np.empty((0, 6))
    loop.controller.on_target_trajectory(
        TrajectorySample(0, frame, times, positions[::-1].copy(), turns, none, none), loop.now
    )
    loop.tick()
    assert "pose 1 of target_trajectory is 0.30 m out of reach" in loop.controller.status.reason


def test_accelerations_of_a_trajectory_are_bounded(loop: Loop) -> None:
    position = np.tile(loop.pose()[:3, 3], (2, 1))
    sample = TrajectorySample(
        0, loop.robot.base_frame, (0, NS), position, np.tile(DOWN, (2, 1)), np.zeros((2, 6)), np.full((2, 6), 1e160)
    )
    with pytest.raises(TargetRefused, match="pose 0 has an acceleration above 1000"):
        loop.controller.on_target_trajectory(sample, loop.now)


def test_a_snapshot_keeps_the_report(loop: Loop) -> None:
    give(loop, beyond(loop.robot, 0.43))
    loop.tick()
    other = Loop(loop.robot, READY["panda"])
    other.controller.restore(loop.controller.capture())
    other.time_ns = loop.time_ns
    other.tick()
    assert "target is 0.43 m out of reach" in other.controller.status.reason

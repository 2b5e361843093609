"""Foresight: the tool keeps the direction of its twist through singular and limit-near postures, and stays on paths.

The poses follow joint motions from corner to corner of the joint ranges, as in ``direction_cases``: twists change at
once, singularities and position limits lie ahead. J is computed by Pinocchio.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from independent_kinematics import Kinematics
from loop import Loop, make_robot

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import PathSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

RATE_HZ = 500.0
ROW_SCALE = np.repeat((1.0, 0.3), 3)
POSES_PER_GOAL = 50
POSE_PERIOD_NS = NS // 50
LARGEST_STEP = 0.02
"""Joint motion from pose to pose, rad."""


def joint_motion(robot: Robot, seed: int, goals: int) -> Array:
    """Joint positions (k, n) from the middle of the ranges to random corners of them, 1 rad/s each."""
    rng, low, high = np.random.default_rng(seed), robot.limits.lower, robot.limits.upper
    low, high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
    aim = low + (high - low) * rng.uniform(0.3, 0.7, robot.n)
    found = [aim]
    for _ in range(goals):
        goal = low + (high - low) * rng.choice([0.02, 0.5, 0.98], robot.n)
        for _ in range(POSES_PER_GOAL):
            found.append(found[-1] + np.clip(goal - found[-1], -LARGEST_STEP, LARGEST_STEP))
    return np.array(found)


def settings(method: str) -> Settings:
    return Settings().with_values({"rate_hz": RATE_HZ, "method": method, "obstacles.self_collision": False})


def streamed(name: str, method: str, seed: int, goals: int) -> Loop:
    """A run with the poses as a stream."""
    robot = make_robot(name)
    aims = joint_motion(robot, seed, goals)
    loop = Loop(robot, aims[0], settings(method))
    for aim in aims[1:]:
        loop.target(robot.pose(aim))
        for _ in range(round(RATE_HZ / 50.0)):
            loop.tick()
    return loop


def on_path(name: str, method: str, seed: int, goals: int, timed: bool) -> Loop:
    """A run with the poses as a nav_msgs/Path, until its end."""
    robot = make_robot(name)
    aims = joint_motion(robot, seed, goals)
    loop = Loop(robot, aims[0], settings(method))
    loop.run(0.1)
    begin_ns = loop.now.ros_ns + NS // 2
    stamps = tuple(begin_ns + index * POSE_PERIOD_NS if timed else 0 for index in range(len(aims)))
    poses = [robot.pose(aim) for aim in aims]
    points, turns = (
        np.array([pose[:3, 3] for pose in poses]),
        np.array([se3.quaternion_from_rotation(pose[:3, :3]) for pose in poses]),
    )
    loop.controller.on_target_path(PathSample((robot.base_frame,) * len(aims), stamps, points, turns), loop.now)
    for _ in range(100 * goals):
        loop.run(0.1)
        if loop.steps[-1].progress >= 1.0:
            break
    assert loop.steps[-1].progress >= 1.0, "the path must end"
    return loop


def off_direction(loop: Loop) -> Array:
    """|D (J qd - s V_f)| / |D V_f| of each step in closed loop."""
    kinematics, previous, found = Kinematics(loop.robot), np.zeros(loop.robot.n), []
    for step in loop.steps:
        followed = ROW_SCALE * (step.twist_b - step.truncated_b)
        size = float(np.linalg.norm(followed))
        if np.isfinite(step.scale) and size > 1e-6:
            done = kinematics.jacobian(step.joint_position + 0.5 / RATE_HZ * previous) @ step.joint_velocity
            found.append(float(np.linalg.norm(ROW_SCALE * done - step.scale * followed)) / size)
        previous = step.joint_velocity
    return np.array(found)


def check_within_limits(loop: Loop) -> None:
    """No command exceeds a velocity or acceleration limit, no joint a position limit."""
    limits, previous = motion_limits(loop.robot, loop.settings.limits, RATE_HZ), np.zeros(loop.robot.n)
    for step in loop.steps:
        assert (np.abs(step.joint_velocity) <= limits.velocity).all()
        assert (np.abs(step.joint_velocity - previous) <= limits.acceleration / RATE_HZ + 1e-9).all()
        assert (step.joint_position >= limits.lower - 1e-6).all()
        assert (step.joint_position <= limits.upper + 1e-6).all()
        previous = step.joint_velocity


STREAMS = [
    ("ur5", "plain", 3, 0.01),
    ("ur10", "plain", 4, 0.01),
    ("panda", "plain", 5, 0.01),
    # Long inside singularities (1 mm): acceleration limits leave 1 to 3 % of V at a scale near 0.
    ("talos_arm", "plain", 6, 0.2),
]


@pytest.mark.parametrize(("name", "method", "seed", "share"), STREAMS)
def test_a_stream_through_singular_and_limit_near_postures_keeps_the_direction(
    name: str, method: str, seed: int, share: float
) -> None:
    """The aim of ``direction_cases``: off by more than 1 % in less than 1 % of the steps, never by more than 10 %."""
    loop = streamed(name, method, seed, 4)
    check_within_limits(loop)
    off = off_direction(loop)
    assert len(off) > 0.9 * len(loop.steps)
    assert np.mean(off > 0.01) < share
    assert off.max() < 0.1


PATHS = [
    ("ur10", "plain", 4, True),
    ("panda", "plain", 5, True),
    ("xarm7", "plain", 6, False),
    ("xarm7", "plain", 3, True),
    ("ur5", "plain", 3, True),
    ("talos_arm", "plain", 2, True),
    ("z1", "plain", 2, True),
]


@pytest.mark.parametrize(("name", "method", "seed", "timed"), PATHS)
def test_a_path_through_the_same_poses_is_followed(name: str, method: str, seed: int, timed: bool) -> None:
    """It slows down before the joints would have to turn faster than they can, and reaches its end, within 1 mm."""
    loop = on_path(name, method, seed, 2, timed)
    check_within_limits(loop)
    distances = [step.path_distance for step in loop.steps if step.progress > 0.0]
    assert max(distances) < 1e-3
    errors = [np.linalg.norm(ROW_SCALE * step.error_b) for step in loop.steps if step.progress > 0.0]
    assert max(errors) < 3e-3, "neither turned nor behind or ahead on the path"


def test_the_rate_of_a_path_changes_without_chattering() -> None:
    """Speeding up and slowing down alternate a few times at each bend, not from step to step."""
    loop = on_path("ur5", "plain", 3, 2, True)
    speeds = np.array(
        [np.linalg.norm(ROW_SCALE * step.feedforward_b) for step in loop.steps if 0.0 < step.progress < 1.0]
    )
    changes = np.diff(speeds)
    changes = changes[np.abs(changes) > 1e-3 * speeds.max()]
    turns = sum(before * after < 0.0 for before, after in pairwise(changes.tolist()))
    assert turns < 0.1 * len(speeds)

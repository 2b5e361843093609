"""The reach of the tool: an upper bound that no pose exceeds, and that is not far above the farthest one."""

from __future__ import annotations

import numpy as np
import pytest
from arms import ball_arm, random_position
from loop import make_robot

from ik_node.robot.reach import MARGIN_M, reach_of
from ik_node.robot.robot import Robot

ARMS = {
    "panda": lambda: make_robot("panda"),
    "ur5": lambda: make_robot("ur5"),
    "kinova": lambda: make_robot("kinova"),
    "so100": lambda: make_robot("so100"),  # a joint has the name of its tip frame
    "prismatic": lambda: ball_arm("rprrpr", "0.4 -0.2 0.7"),
}


@pytest.mark.parametrize("name", ARMS)
def test_no_pose_is_out_of_reach(name: str) -> None:
    robot: Robot = ARMS[name]()
    reach, rng = reach_of(robot), np.random.default_rng(0)
    points = np.array([robot.pose(random_position(robot, rng))[:3, 3] for _ in range(2000)])
    assert (np.linalg.norm(points - reach.centre_s, axis=1) <= reach.radius).all()
    assert not reach.excess(points).any()


@pytest.mark.parametrize(("name", "most"), [("panda", 1.5), ("ur5", 1.35)])
def test_the_bound_is_not_far_above_the_farthest_pose(name: str, most: float) -> None:
    robot: Robot = ARMS[name]()
    reach, rng = reach_of(robot), np.random.default_rng(1)
    points = np.array([robot.pose(random_position(robot, rng))[:3, 3] for _ in range(5000)])
    assert reach.radius < most * np.linalg.norm(points - reach.centre_s, axis=1).max()


def test_the_excess_is_the_distance_from_the_bound() -> None:
    reach = reach_of(make_robot("panda"))
    outwards = np.array([0.0, 0.6, 0.8])
    points = reach.centre_s + np.array([[0.0], [reach.radius + 0.5 * MARGIN_M], [reach.radius + 0.43]]) * outwards
    assert reach.excess(points) == pytest.approx([0.0, 0.0, 0.43])


def test_the_first_joint_does_not_move_the_centre() -> None:
    robot = ball_arm("rprrpr", "0.4 -0.2 0.7")
    origin = robot.joint_origins(np.zeros(robot.n))[0]
    assert reach_of(robot).centre_s == pytest.approx(origin)

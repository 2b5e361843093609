"""The arms that are measured, and random positions of theirs."""

from __future__ import annotations

import numpy as np

from ik_node import catalogue
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import ArmSettings

ROBOTS = ("panda", "ur5", "ur10", "talos_arm", "xarm7", "kinova")


def arm(name: str) -> Robot:
    """A robot of example-robot-data by name."""
    return catalogue.robot_from(ArmSettings(robot=name))


def random_position(robot: Robot, rng: np.random.Generator) -> Array:
    """q, (n,), uniform in the limits, in one turn where there are none."""
    lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    return rng.uniform(lower, upper)

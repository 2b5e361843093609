"""The arms of the benchmarks and their random positions."""

from __future__ import annotations

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.catalogue import load_robot
from ik_node.robot.robot import Robot

ROBOTS = ("panda", "ur5", "ur10", "talos_arm", "xarm7", "kinova")


def arm(name: str) -> Robot:
    """Load an arm of example-robot-data."""
    return load_robot(name)


def random_position(robot: Robot, rng: np.random.Generator) -> Array:
    """Draw q, (n,), uniformly within the limits; within one turn where there are none."""
    lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    return rng.uniform(lower, upper)

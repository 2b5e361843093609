"""Test arms with collision geometry that has closed-form distances; random positions of any arm."""

from __future__ import annotations

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.robot import Robot


def random_position(robot: Robot, rng: np.random.Generator) -> Array:
    """Draw q, (n,), uniformly within the limits; within one turn where there are none."""
    lower = np.where(np.isfinite(robot.limits.lower), robot.limits.lower, -np.pi)
    upper = np.where(np.isfinite(robot.limits.upper), robot.limits.upper, np.pi)
    return rng.uniform(lower, upper)


def ball_arm(joint_types: str = "rrrrrr", base_offset: str = "0 0 0") -> Robot:
    """Arm of links of 0.3 m, each with one ball of 5 cm at its end; joints about (along) y, z, x in turn.

    ``base_offset``: x y z of the first joint; the base frame is that of a plate that is rotated relative to the root.
    """
    axes = ("0 1 0", "0 0 1", "1 0 0")
    parts = [
        '<robot name="balls"><link name="root"/><link name="plate"/>',
        '<joint name="stand" type="fixed"><parent link="root"/><child link="plate"/>'
        f'<origin xyz="{base_offset}" rpy="0.3 -0.2 1.0"/></joint>',
    ]
    parent = "plate"
    for index, kind in enumerate(joint_types):
        name = f"link{index + 1}"
        parts.append(
            f'<link name="{name}"><inertial><mass value="1"/><origin xyz="0 0 0.15"/>'
            '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
            '<collision><origin xyz="0 0 0.3"/><geometry><sphere radius="0.05"/></geometry></collision></link>'
            f'<joint name="joint{index + 1}" type="{"revolute" if kind == "r" else "prismatic"}">'
            f'<parent link="{parent}"/><child link="{name}"/><origin xyz="0 0 {0.0 if index == 0 else 0.3}"/>'
            f'<axis xyz="{axes[index % 3]}"/><limit lower="-2" upper="2" velocity="2" effort="9"/></joint>'
        )
        parent = name
    return Robot("".join(parts) + "</robot>", base_frame="plate", tip_frame=parent)

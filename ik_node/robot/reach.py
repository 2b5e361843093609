"""Reach of an arm: an upper bound of the distance at which its tool can be."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.reduced_model import frame_id
from ik_node.robot.robot import Robot

MARGIN_M = 0.01
"""Positions up to this far beyond the bound are not reported: targets at full stretch are noisy."""


class Reach(NamedTuple):
    """A sphere outside which the tool cannot be."""

    centre_s: Array
    """Origin of the first joint between base and tool, in the base frame, (3,), m."""
    radius: float
    """Sum of the lengths of the links and of the strokes of prismatic joints, m; inf for a stroke without limits."""

    def excess(self, positions_s: Array) -> Array:
        """Distance by which positions in the base frame, (..., 3), m, are out of reach, (...,), m; 0 within reach."""
        excess = np.linalg.norm(positions_s - self.centre_s, axis=-1) - self.radius
        return np.asarray(np.where(excess > MARGIN_M, excess, 0.0))


def reach_of(robot: Robot) -> Reach:
    """The reach of a robot's tool. Limits of revolute joints are not used, so the tool may reach less than this."""
    model = robot.model
    tip = model.frames[frame_id(model, robot.tip_frame)]
    chain = [joint for joint in model.supports[tip.parentJoint] if joint > 0]
    radius = float(np.linalg.norm(tip.placement.translation))
    first = model.jointPlacements[chain[0]].translation if chain else tip.placement.translation
    for number, joint in enumerate(chain):
        own = robot.joint_moves(joint) & ~robot.joint_moves(model.parents[joint])
        if not robot.moving_revolute[own].all():
            radius += float(robot.strokes[own].max())
        if number:
            radius += float(np.linalg.norm(model.jointPlacements[joint].translation))
    pose = robot.pose_base_root
    return Reach(np.asarray(pose[:3, :3] @ first + pose[:3, 3]), radius)

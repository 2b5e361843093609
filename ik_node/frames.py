"""Frames in which targets and obstacles come, seen from the base."""

from __future__ import annotations

import numpy as np

from ik_node import se3
from ik_node.errors import InputError
from ik_node.inputs import ObstacleSample, PoseSample
from ik_node.robot import Robot
from ik_node.se3 import Array


class Frames:
    """Every frame of the robot's model; those that the arm moves are where the last measurement has them."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.position: Array | None = None
        """Last measured joint positions, (n,); None before the first."""

    def known(self, frame: str) -> str:
        """``frame`` itself; InputError with the frames that there are when it is none of them."""
        if frame not in self._robot.frames:
            raise InputError(f"unknown frame '{frame}'; valid: {', '.join(sorted(self._robot.frames))}")
        return frame

    def pose(self, frame: str) -> Array:
        """T_sf, (4, 4); InputError when the frame is unknown, or the arm's position is."""
        if self.known(frame) == self._robot.base_frame:
            return np.eye(4)
        if self.position is None:
            raise InputError(f"frame '{frame}' cannot be placed before the first joint state")
        return self._robot.frame_pose(self.position, frame)

    def place(self, sample: PoseSample | ObstacleSample, what: str) -> Array:
        """The sample's pose as T_s, (4, 4); InputError naming ``what`` when it is no pose."""
        pose = se3.pose_from(sample.position, sample.quaternion, what)
        placed: Array = self.pose(sample.frame_id) @ pose
        return placed

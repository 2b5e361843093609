"""Poses of the frames in which targets and obstacles are expressed.

Frames of the robot model follow from the joint positions. Poses of other frames (a camera, a table) come from tf; they
are inputs of the controller and recorded like the others, so a replay uses the same poses.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.samples import ObstacleSample, PoseSample
from ik_node.math import se3
from ik_node.math.numerics import checked_vector
from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class FramesSnapshot(NamedTuple):
    """Attributes of a :class:`Frames`, without the last measurement."""

    transforms: dict[str, Array]


class Frames:
    """Frames of the robot model at the last measured positions, and external frames at their last pose from tf."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.position: Array | None = None
        """Last measured joint positions, (n,); None before the first."""
        self.transforms: dict[str, Array] = {}
        """External frame -> its last pose T_sf, (4, 4)."""

    def set_transform(self, text: str) -> None:
        """Sets the pose of an external frame from the text of :func:`transform_text`; raises InputError for others."""
        frame, *numbers = text.split(" ")
        try:
            values = checked_vector([float(number) for number in numbers], 7, f"transform of '{frame}'")
        except ValueError as error:
            raise InputError(f"transform of '{frame}' does not have seven numbers: {error}") from error
        if frame not in self._robot.frames:
            self.transforms[frame] = se3.pose_from(values[:3], values[3:], f"transform of '{frame}'")

    def checked(self, frame: str) -> str:
        """Returns ``frame``, or the base frame if it is empty; raises InputError listing the known frames."""
        if not frame:
            return self._robot.base_frame
        if frame not in self._robot.frames and frame not in self.transforms:
            valid = sorted({*self._robot.frames, *self.transforms})
            raise InputError(f"unknown frame '{frame}'; valid: {', '.join(valid)}")
        return frame

    def pose(self, frame: str) -> Array:
        """Pose of a frame in the base frame.

        Args:
            frame: Name of a frame of the model or of an external frame.

        Returns:
            T_sf, (4, 4).

        Raises:
            InputError: The frame is unknown (lists the known frames), or no joint positions have been measured yet.
        """
        frame = self.checked(frame)
        if frame in self.transforms:
            return self.transforms[frame]
        if frame == self._robot.base_frame:
            return np.eye(4)
        if self.position is None:
            raise InputError(f"frame '{frame}' has no pose before the first joint state")
        return self._robot.frame_pose(self.position, frame)

    def pose_of(self, sample: PoseSample | ObstacleSample, what: str) -> Array:
        """Pose of a target or obstacle in the base frame.

        Args:
            sample: The target or obstacle.
            what: Its name in error messages.

        Returns:
            The pose, (4, 4).

        Raises:
            InputError: Position or quaternion are not a pose, or the frame has no pose.
        """
        pose = se3.pose_from(sample.position, sample.quaternion, what)
        if self.is_base(sample.frame_id):  # the usual case
            return pose
        return np.asarray(self.pose(sample.frame_id) @ pose)

    def is_base(self, frame: str) -> bool:
        """True for the base frame, and for an empty name."""
        return not frame or (frame == self._robot.base_frame and frame not in self.transforms)


def transform_text(frame: str, position: Sequence[float], quaternion: Sequence[float]) -> str:
    """Text of the pose of a frame in the base frame, without loss of bits: name, x y z in m, quaternion x y z w."""
    return " ".join((frame, *(repr(float(value)) for value in (*position, *quaternion))))

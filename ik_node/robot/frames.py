"""Frames in which targets and obstacles come, seen from the base.

Those of the robot's model are known by themselves. Others (a camera, a table) are told from outside, as answers of tf:
what was answered is an input like any other, so that a replay has it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.samples import ObstacleSample, PoseSample
from ik_node.math import se3
from ik_node.math.se3 import vector
from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class FramesSnapshot(NamedTuple):
    """What :class:`Frames` remembers beside the last measurement."""

    answers: dict[str, Array]


class Frames:
    """Every frame of the robot's model, those that the arm moves where the last measurement has them; and answers."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.position: Array | None = None
        """Last measured joint positions, (n,); None before the first."""
        self.answers: dict[str, Array] = {}
        """Frame outside the model -> T_sf, (4, 4), as last answered."""

    def answer(self, text: str) -> None:
        """Takes where a frame outside the model is, as :func:`answer_text` writes it; InputError when it is no pose."""
        frame, *numbers = text.split(" ")
        try:
            values = vector([float(number) for number in numbers], 7, f"transform of '{frame}'")
        except ValueError as error:
            raise InputError(f"transform of '{frame}' is no seven numbers: {error}") from error
        if frame not in self._robot.frames:
            self.answers[frame] = se3.pose_from(values[:3], values[3:], f"transform of '{frame}'")

    def known(self, frame: str) -> str:
        """``frame`` itself; InputError with the frames that there are when it is none of them."""
        if frame not in self._robot.frames and frame not in self.answers:
            valid = sorted({*self._robot.frames, *self.answers})
            raise InputError(f"unknown frame '{frame}'; valid: {', '.join(valid)}")
        return frame

    def pose(self, frame: str) -> Array:
        """T_sf, (4, 4); InputError when the frame is unknown, or the arm's position is."""
        if self.known(frame) in self.answers:
            return self.answers[frame]
        if frame == self._robot.base_frame:
            return np.eye(4)
        if self.position is None:
            raise InputError(f"frame '{frame}' cannot be placed before the first joint state")
        return self._robot.frame_pose(self.position, frame)

    def place(self, sample: PoseSample | ObstacleSample, what: str) -> Array:
        """The sample's pose as T_s, (4, 4); InputError naming ``what`` when it is no pose."""
        pose = se3.pose_from(sample.position, sample.quaternion, what)
        frame = sample.frame_id
        if frame == self._robot.base_frame and frame not in self.answers:  # as nearly always
            return pose
        return np.asarray(self.pose(frame) @ pose)


def answer_text(frame: str, position: Sequence[float], quaternion: Sequence[float]) -> str:
    """A frame's place in the base frame as a text that gives the same bits back: name, x y z, m, and x y z w."""
    return " ".join((frame, *(repr(float(value)) for value in (*position, *quaternion))))

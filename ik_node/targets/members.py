"""Targets of a task with a tolerance: each is replaced by the member of its family that is nearest to a reference.

So whatever a target does in its free direction, the sources of targets receive the same poses and twists, see
:mod:`ik_node.math.task_member`. With all components exact, everything passes unchanged.
"""

from __future__ import annotations

import numpy as np

from ik_node.math.quaternion import (
    Quaternion,
    conjugate,
    from_matrix,
    multiply,
    normalised,
    pose_position,
    pose_quaternion,
    rotate,
    rotate_inverse,
)
from ik_node.math.task_error import TaskForm
from ik_node.math.task_member import nearest_member, without_free_part
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.settings.task import TaskSettings
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.jog import TwistFrame
from ik_node.targets.stream.extrapolation import resting


def at_pose(motion: RigidMotion, pose: Array) -> RigidMotion:
    """``motion`` at another pose (4, 4)."""
    x, y, z = pose[:3, 3].tolist()
    return motion._replace(position=(x, y, z), orientation=from_matrix(pose))


class TaskMembers:
    """Members of targets, for one tolerance."""

    def __init__(self, task: TaskSettings, start: RigidMotion | None = None) -> None:
        """``start``: reference of :meth:`path`, the present reference motion."""
        tolerance = TaskTolerance(task.tolerance, task.frame)
        self._form: TaskForm | None = None if tolerance.is_exact else tolerance.form
        self._start = start

    @property
    def follows_whole_pose(self) -> bool:
        """True if all components are exact, and every target is its only member."""
        return self._form is None

    def pose(self, pose_sd: Array, near_sd: Array) -> Array:
        """The member (4, 4) of a target that is nearest to a reference pose (4, 4)."""
        if self._form is None:
            return pose_sd
        near = pose_position(near_sd), pose_quaternion(near_sd)
        return pose_matrix(resting(*nearest_member(self._form, pose_position(pose_sd), from_matrix(pose_sd), *near)))

    def path(self, positions: Array, orientations: tuple[Quaternion, ...]) -> tuple[Array, tuple[Quaternion, ...]]:
        """The members of the poses of a path, each nearest to the one before.

        Args:
            positions: (N, 3), m.
            orientations: N times R_sd, (w, x, y, z).
        """
        if self._form is None or self._start is None:
            return positions, orientations
        near = self._start.position, self._start.orientation
        members = []
        for position, orientation in zip(positions.tolist(), orientations, strict=True):
            near = nearest_member(self._form, tuple(position), orientation, *near)
            members.append(near)
        return np.array([member[0] for member in members]), tuple(member[1] for member in members)

    def twist(self, twist: Array, frame: TwistFrame, reference: RigidMotion) -> Array:
        """A twist of the tool point (6,) in the axes of a frame, without what is free at the present reference."""
        if self._form is None:
            return twist
        turn = from_matrix(frame.rotation)
        if frame.in_tool:
            turn = multiply(reference.orientation, turn)
        x, y, z, a, b, c = twist.tolist()
        velocity, rate = without_free_part(
            self._form, reference.orientation, rotate(turn, (x, y, z)), rotate(turn, (a, b, c))
        )
        return np.array((*rotate_inverse(turn, velocity), *rotate_inverse(turn, rate)))

    def path_twists(
        self,
        poses: tuple[Array, tuple[Quaternion, ...]],
        members: tuple[Array, tuple[Quaternion, ...]],
        velocities: Array,
        rates: Array,
    ) -> tuple[Array, Array] | None:
        """Twists of the members of a path.

        Args:
            poses: Positions (N, 3) and orientations of the targets.
            members: The same of their members.
            velocities: Of the targets in {s}, (N, 3), m/s.
            rates: In the frames of the targets, (N, 3), rad/s.

        Returns:
            Velocities in {s} and rates in the frames of the members; None if every member is the target itself.
        """
        form = self._form
        if form is None:
            return None
        offsets = members[0] - poses[0]
        rows = []
        for index, (target, member) in enumerate(zip(poses[1], members[1], strict=True)):
            rate = rotate(target, tuple(rates[index].tolist()))
            velocity = velocities[index]
            if form.in_base:
                # the members turn with the target and about a fixed axis of {s}
                rate = rotate(normalised(multiply(member, conjugate(target))), rate)
            else:
                velocity = velocity + np.cross(rate, offsets[index])
            kept_velocity, kept_rate = without_free_part(form, member, tuple(velocity.tolist()), rate)
            rows.append((*kept_velocity, *rotate_inverse(member, kept_rate)))
        twists = np.array(rows)
        return twists[:, :3], twists[:, 3:]


WHOLE_POSE = TaskMembers(TaskSettings())
"""Every target is its only member."""

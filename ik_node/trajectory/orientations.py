"""Rotation matrices from the columns of an orientation."""

from __future__ import annotations

import numpy as np

from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory.pose_columns import MATRIX, ROTATION_VECTOR, RPY


def rotations(values: Array, form: str) -> Array:
    """Rotation matrices (N, 3, 3).

    Args:
        values: One orientation per row: quaternions (N, 4), angles or rotation vectors (N, 3) in rad, or the entries of
            matrices, row by row (N, 9).
        form: "xyzw" or "wxyz" for a quaternion, or a form of :mod:`~ik_node.trajectory.pose_columns`.

    Raises:
        InputError: A quaternion has not the norm 1, or a matrix is no rotation; the message has the sample.
    """
    if form == RPY:
        return _from_rpy(values)
    if form == ROTATION_VECTOR:
        return np.array([se3.exp_rotation(vector) for vector in values])
    if form == MATRIX:
        poses = np.tile(np.eye(4), (len(values), 1, 1))
        poses[:, :3, :3] = values.reshape(-1, 3, 3)
        return np.array([se3.checked_pose(pose, f"sample {index}")[:3, :3] for index, pose in enumerate(poses)])
    quaternions = np.roll(values, -1, axis=1) if form == "wxyz" else values
    found = np.empty((len(values), 3, 3))
    for index, quaternion in enumerate(quaternions):
        try:
            found[index] = se3.rotation_from_quaternion(quaternion)
        except InputError as error:
            raise InputError(f"sample {index}: {error}") from error
    return found


def _from_rpy(angles: Array) -> Array:
    """R_z(yaw) R_y(pitch) R_x(roll), as in URDF."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(angles.T), np.cos(angles.T)
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return np.moveaxis(np.array(rows), 2, 0)

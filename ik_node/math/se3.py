"""Rigid motions: checked poses, exponential, logarithm, adjoint.

Poses are 4x4 arrays ``T_ab`` (frame {b} expressed in {a}). Twists and wrenches are arrays (6,), **linear part first**
(v, omega), as in Pinocchio and ROS. The lecture notes write the angular part first; :func:`angular_first` converts
between both orders.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.numerics import checked_vector
from ik_node.math.quaternion import (
    cross,
    difference,
    dot,
    from_matrix,
    from_rotation_vector,
    pose_position,
    pose_quaternion,
    to_matrix,
    to_rotation_vector,
)
from ik_node.math.so3 import inverse_coefficient, jacobian_coefficients
from ik_node.math.types import Array

ROTATION_TOLERANCE = 1e-3
"""Largest deviation of a quaternion from unit norm, or of a matrix from SO(3), that is corrected; larger ones raise."""

_ORIGIN = np.eye(4)


def rotation_from_quaternion(xyzw: ArrayLike, name: str = "orientation") -> Array:
    """Rotation matrix of a quaternion.

    Args:
        xyzw: x, y, z, w, (4,); normalised if its norm is within ``ROTATION_TOLERANCE`` of 1.
        name: What the error message calls the rotation.

    Returns:
        R, (3, 3).

    Raises:
        InputError: The norm is further from 1 (for example 0), or an entry is not finite.
    """
    x, y, z, w = checked_vector(xyzw, 4, f"{name} quaternion").tolist()
    norm = sqrt(x * x + y * y + z * z + w * w)
    if abs(norm - 1.0) > ROTATION_TOLERANCE:
        raise InputError(f"{name} quaternion has norm {norm:.6g}; accepted: 1 within {ROTATION_TOLERANCE}")
    return np.array(to_matrix((w / norm, x / norm, y / norm, z / norm)))


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion x, y, z, w of a rotation matrix (3, 3), with w >= 0."""
    w, x, y, z = from_matrix(rotation)
    return np.array((-x, -y, -z, -w) if w < 0.0 else (x, y, z, w))


def checked_pose(matrix: ArrayLike, name: str = "pose") -> Array:
    """A copy of a matrix as an exact rigid motion.

    The rotation is projected onto SO(3) (nearest matrix in the Frobenius norm).

    Args:
        matrix: (4, 4), in metres.
        name: What the error message calls the pose.

    Raises:
        InputError: ``matrix`` is not finite, has another shape, is further than ``ROTATION_TOLERANCE`` from SO(3), or
            its last row is not 0 0 0 1.
    """
    pose = np.array(matrix, dtype=np.float64)
    if pose.shape != (4, 4):
        raise InputError(f"{name} has shape {pose.shape}, expected (4, 4)")
    if not np.isfinite(pose).all():
        raise InputError(f"{name} is not finite: {pose.tolist()}")
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > ROTATION_TOLERANCE:
        raise InputError(f"{name} has last row {pose[3].tolist()}, expected 0 0 0 1")
    u, _, vt = np.linalg.svd(pose[:3, :3])
    nearest = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    distance = float(np.abs(nearest - pose[:3, :3]).max())
    if distance > ROTATION_TOLERANCE:
        raise InputError(f"{name} is {distance:.3g} away from a rotation; accepted: {ROTATION_TOLERANCE}")
    pose[:3, :3] = nearest
    pose[3] = (0.0, 0.0, 0.0, 1.0)
    return pose


def pose_from(position: ArrayLike, quaternion_xyzw: ArrayLike, name: str = "pose") -> Array:
    """Pose (4, 4) of a position (3,) in metres and a quaternion x, y, z, w.

    Raises:
        InputError: As :func:`rotation_from_quaternion`, or the position is not finite.
    """
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(quaternion_xyzw, name)
    pose[:3, 3] = checked_vector(position, 3, f"{name} position")
    return pose


def inverse(pose: Array) -> Array:
    """The inverse T_ba of a pose T_ab, (4, 4)."""
    return relative_pose(_as_pose(pose), _ORIGIN)


def exp(twist: Array) -> Array:
    """Exponential of se(3): the pose (4, 4) reached from the identity by the constant ``twist`` (v, omega) in 1 s."""
    return exp6(_as_vector(twist, 6))


def log(pose: Array) -> Array:
    """Logarithm of SE(3): the twist (v, omega), (6,), that leads from the identity to ``pose`` (4, 4) in 1 s.

    The rotation angle is in [0, pi]. At exactly pi both signs of the axis are solutions, and one of them is returned.
    Accurate to rounding near 0 and near pi.
    """
    return log6(_as_pose(pose))


def exp_rotation(rotation_vector: Array) -> Array:
    """Exponential of so(3): the rotation matrix (3, 3) of a rotation vector (3,), rad."""
    x, y, z = _as_vector(rotation_vector, 3).tolist()
    return np.array(to_matrix(from_rotation_vector((x, y, z))))


def log_rotation(rotation: Array) -> Array:
    """Logarithm of SO(3): the rotation vector (3,) of a rotation matrix (3, 3), length in [0, pi] rad."""
    return np.array(to_rotation_vector(from_matrix(rotation)))


def adjoint(pose: Array) -> Array:
    """The adjoint Ad(T_ab), (6, 6): maps a twist (v, omega) expressed in {b} to the same twist expressed in {a}."""
    return action_matrix(_as_pose(pose))


def _as_pose(pose: ArrayLike) -> Array:
    """A C-contiguous float array (4, 4), as compiled functions expect."""
    matrix = np.ascontiguousarray(pose, dtype=np.float64)
    if matrix.shape != (4, 4):
        raise InputError(f"pose has shape {matrix.shape}, expected (4, 4)")
    return matrix


def _as_vector(values: ArrayLike, size: int) -> Array:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InputError(f"vector has shape {array.shape}, expected ({size},)")
    return array


# --- compiled and unchecked: C-contiguous float arrays of the right shape ---------------------------------------------


@compiled
def relative_pose(pose_sa: Array, pose_sb: Array) -> Array:
    """T_ab = T_sa^-1 T_sb."""
    pose = np.empty((4, 4))
    x, y, z = difference(pose_position(pose_sb), pose_position(pose_sa))
    for i in range(3):
        rx, ry, rz = pose_sa[0, i], pose_sa[1, i], pose_sa[2, i]
        for j in range(3):
            pose[i, j] = rx * pose_sb[0, j] + ry * pose_sb[1, j] + rz * pose_sb[2, j]
        pose[i, 3] = rx * x + ry * y + rz * z
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def compose(pose_sa: Array, pose_ab: Array) -> Array:
    """T_sb = T_sa T_ab."""
    pose = np.empty((4, 4))
    for i in range(3):
        x, y, z = pose_sa[i, 0], pose_sa[i, 1], pose_sa[i, 2]
        for j in range(4):
            pose[i, j] = x * pose_ab[0, j] + y * pose_ab[1, j] + z * pose_ab[2, j]
        pose[i, 3] += pose_sa[i, 3]
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def exp6(twist: Array) -> Array:
    """:func:`exp`, compiled."""
    v, theta = (twist[0], twist[1], twist[2]), (twist[3], twist[4], twist[5])
    # V v, with V = 1 + a [theta] + b [theta]^2 the left Jacobian
    a, b = jacobian_coefficients(dot(theta, theta))
    once = cross(theta, v)
    twice = cross(theta, once)
    pose, rows = np.empty((4, 4)), to_matrix(from_rotation_vector(theta))
    for i in range(3):
        pose[i, 0], pose[i, 1], pose[i, 2] = rows[i]
        pose[i, 3] = v[i] + a * once[i] + b * twice[i]
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def log6(pose: Array) -> Array:
    """:func:`log`, compiled."""
    theta, p = to_rotation_vector(pose_quaternion(pose)), pose_position(pose)
    # V^-1 p, with V^-1 = 1 - [theta] / 2 + c [theta]^2
    c = inverse_coefficient(dot(theta, theta))
    once = cross(theta, p)
    twice = cross(theta, once)
    twist = np.empty(6)
    for i in range(3):
        twist[i], twist[3 + i] = p[i] - 0.5 * once[i] + c * twice[i], theta[i]
    return twist


@compiled
def action_matrix(pose_ab: Array) -> Array:
    """:func:`adjoint`, compiled."""
    matrix = np.zeros((6, 6))
    p = pose_position(pose_ab)
    for j in range(3):
        axis = (pose_ab[0, j], pose_ab[1, j], pose_ab[2, j])
        moved = cross(p, axis)
        for i in range(3):
            matrix[i, j] = matrix[3 + i, 3 + j] = axis[i]
            matrix[i, 3 + j] = moved[i]
    return matrix


@compiled
def transform_twist(pose_ab: Array, twist_b: Array) -> Array:
    """Ad(T_ab) V_b: a twist (v, omega) expressed in {b}, expressed in {a}."""
    twist = np.empty(6)
    for i in range(3):
        x, y, z = pose_ab[i, 0], pose_ab[i, 1], pose_ab[i, 2]
        twist[i] = x * twist_b[0] + y * twist_b[1] + z * twist_b[2]
        twist[3 + i] = x * twist_b[3] + y * twist_b[4] + z * twist_b[5]
    moved = cross(pose_position(pose_ab), (twist[3], twist[4], twist[5]))
    for i in range(3):
        twist[i] += moved[i]
    return twist


def angular_first(twist: Any) -> Array:
    """Swaps the halves (v, omega) <-> (omega, v) of a twist or wrench (6,) or of a Jacobian (6, n), along axis 0."""
    array = np.asarray(twist, dtype=np.float64)
    return np.concatenate((array[3:], array[:3]))

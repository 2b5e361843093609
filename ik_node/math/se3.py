"""Rigid motions: checked input, exponential, logarithm, adjoint.

Poses are 4x4 arrays ``T_ab`` (frame {b} seen from {a}). Twists and wrenches are length-6 arrays, **linear part first**
(v, omega), as Pinocchio and ROS have it. The lecture notes write the angular part first; :func:`angular_first` turns
one into the other, and this is the only place that says so.
"""

from __future__ import annotations

from math import isfinite, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.quaternion import (
    cross,
    difference,
    dot,
    from_matrix,
    from_vector,
    orientation_in,
    position_in,
    to_matrix,
    to_vector,
)
from ik_node.math.so3 import inverse_coefficient, jacobian_coefficients
from ik_node.math.types import Array

ROTATION_TOLERANCE = 1e-3
"""How far from unit norm a quaternion, or from SO(3) a matrix, may be and still be put right instead of refused."""


_ORIGIN = np.eye(4)


def vector(values: ArrayLike, size: int, name: str) -> Array:
    """A finite float vector of ``size`` entries; InputError naming ``name`` otherwise."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InputError(f"{name} has shape {array.shape}, expected ({size},)")
    if not all(map(isfinite, array.tolist())):
        raise InputError(f"{name} is not finite: {array}")
    return array


def rotation_from_quaternion(xyzw: ArrayLike, name: str = "orientation") -> Array:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w.

    Normalised when its norm is within ``ROTATION_TOLERANCE`` of 1; InputError beyond (zero too) or when not finite.
    """
    x, y, z, w = vector(xyzw, 4, f"{name} quaternion").tolist()
    norm = sqrt(x * x + y * y + z * z + w * w)
    if abs(norm - 1.0) > ROTATION_TOLERANCE:
        raise InputError(f"{name} quaternion has norm {norm:.6g}; accepted: 1 within {ROTATION_TOLERANCE}")
    return np.array(to_matrix((w / norm, x / norm, y / norm, z / norm)))


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion x, y, z, w of a rotation matrix (3, 3), with w >= 0."""
    w, x, y, z = from_matrix(rotation)
    return np.array((-x, -y, -z, -w) if w < 0.0 else (x, y, z, w))


def checked_pose(matrix: ArrayLike, name: str = "pose") -> Array:
    """A copy of ``matrix`` (4, 4) as an exact rigid motion.

    The rotation is projected onto SO(3) (nearest in the Frobenius norm) when within ``ROTATION_TOLERANCE`` of it.
    InputError beyond, when not finite, of another shape, or when the last row is not 0 0 0 1.
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
    """Pose (4, 4) of a position in metres and a quaternion x, y, z, w; checked as the parts are."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_quaternion(quaternion_xyzw, name)
    pose[:3, 3] = vector(position, 3, f"{name} position")
    return pose


def inverse(pose: Array) -> Array:
    """T_ba of T_ab."""
    return between(_as_pose(pose), _ORIGIN)


def exp(twist: Array) -> Array:
    """Pose (4, 4) reached from the identity by following ``twist`` (v, omega) for one second."""
    return pose_after(_as_vector(twist, 6))


def log(pose: Array) -> Array:
    """The twist (v, omega) that leads from the identity to ``pose`` in one second; rotation angle in [0, pi].

    At exactly pi the axis has two signs, both right; one is chosen. Accurate to rounding near 0 and near pi.
    """
    return twist_to(_as_pose(pose))


def exp_rotation(rotation_vector: Array) -> Array:
    """Rotation matrix (3, 3) about ``rotation_vector`` by its length in rad."""
    x, y, z = _as_vector(rotation_vector, 3).tolist()
    return np.array(to_matrix(from_vector((x, y, z))))


def log_rotation(rotation: Array) -> Array:
    """Rotation vector (3,) of ``rotation``, length in [0, pi]."""
    return np.array(to_vector(from_matrix(rotation)))


def adjoint(pose: Array) -> Array:
    """Ad(T_ab), (6, 6): turns a twist (v, omega) written in {b} into the same twist written in {a}."""
    return adjoint_of(_as_pose(pose))


def _as_pose(pose: ArrayLike) -> Array:
    """As compiled functions take it."""
    matrix = np.ascontiguousarray(pose, dtype=np.float64)
    if matrix.shape != (4, 4):
        raise InputError(f"pose has shape {matrix.shape}, expected (4, 4)")
    return matrix


def _as_vector(values: ArrayLike, size: int) -> Array:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InputError(f"vector has shape {array.shape}, expected ({size},)")
    return array


# --- the same for compiled code: C-contiguous arrays of the right shape, unchecked ------------------------------------


@compiled
def between(pose_sa: Array, pose_sb: Array) -> Array:
    """T_ab = T_sa^-1 T_sb."""
    pose = np.empty((4, 4))
    x, y, z = difference(position_in(pose_sb), position_in(pose_sa))
    for i in range(3):
        rx, ry, rz = pose_sa[0, i], pose_sa[1, i], pose_sa[2, i]
        for j in range(3):
            pose[i, j] = rx * pose_sb[0, j] + ry * pose_sb[1, j] + rz * pose_sb[2, j]
        pose[i, 3] = rx * x + ry * y + rz * z
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def times(pose_sa: Array, pose_ab: Array) -> Array:
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
def pose_after(twist: Array) -> Array:
    """:func:`exp`."""
    v, turn = (twist[0], twist[1], twist[2]), (twist[3], twist[4], twist[5])
    # V v, with V = 1 + a [turn] + b [turn]^2 the left Jacobian
    a, b = jacobian_coefficients(dot(turn, turn))
    once = cross(turn, v)
    twice = cross(turn, once)
    pose, rows = np.empty((4, 4)), to_matrix(from_vector(turn))
    for i in range(3):
        pose[i, 0], pose[i, 1], pose[i, 2] = rows[i]
        pose[i, 3] = v[i] + a * once[i] + b * twice[i]
    pose[3, 0], pose[3, 1], pose[3, 2], pose[3, 3] = 0.0, 0.0, 0.0, 1.0
    return pose


@compiled
def twist_to(pose: Array) -> Array:
    """:func:`log`."""
    turn, p = to_vector(orientation_in(pose)), position_in(pose)
    # V^-1 p, with V^-1 = 1 - [turn] / 2 + c [turn]^2
    c = inverse_coefficient(dot(turn, turn))
    once = cross(turn, p)
    twice = cross(turn, once)
    twist = np.empty(6)
    for i in range(3):
        twist[i], twist[3 + i] = p[i] - 0.5 * once[i] + c * twice[i], turn[i]
    return twist


@compiled
def adjoint_of(pose_ab: Array) -> Array:
    """:func:`adjoint`."""
    matrix = np.zeros((6, 6))
    p = position_in(pose_ab)
    for j in range(3):
        axis = (pose_ab[0, j], pose_ab[1, j], pose_ab[2, j])
        moved = cross(p, axis)
        for i in range(3):
            matrix[i, j] = matrix[3 + i, 3 + j] = axis[i]
            matrix[i, 3 + j] = moved[i]
    return matrix


@compiled
def carried(pose_ab: Array, twist_b: Array) -> Array:
    """Ad(T_ab) V: the twist (v, omega) written in {b}, written in {a}."""
    twist = np.empty(6)
    for i in range(3):
        x, y, z = pose_ab[i, 0], pose_ab[i, 1], pose_ab[i, 2]
        twist[i] = x * twist_b[0] + y * twist_b[1] + z * twist_b[2]
        twist[3 + i] = x * twist_b[3] + y * twist_b[4] + z * twist_b[5]
    moved = cross(position_in(pose_ab), (twist[3], twist[4], twist[5]))
    for i in range(3):
        twist[i] += moved[i]
    return twist


def angular_first(twist: Any) -> Array:
    """Swaps the halves along axis 0, (v, omega) <-> (omega, v), of a twist or wrench (6,) or a Jacobian (6, n)."""
    array = np.asarray(twist, dtype=np.float64)
    return np.concatenate((array[3:], array[:3]))

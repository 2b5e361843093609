"""Rigid motions: checked input, exponential, logarithm, adjoint.

Poses are 4x4 arrays ``T_ab`` (frame {b} seen from {a}). Twists and wrenches are length-6 arrays, **linear part first**
(v, omega), as Pinocchio and ROS have it. The lecture notes write the angular part first; :func:`angular_first` turns
one into the other, and this is the only place that says so.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ik_node.errors import InputError

Array = NDArray[np.float64]

ROTATION_TOLERANCE = 1e-3
"""How far from unit norm a quaternion, or from SO(3) a matrix, may be and still be put right instead of refused."""


def vector(values: ArrayLike, size: int, name: str) -> Array:
    """A finite float vector of ``size`` entries; InputError naming ``name`` otherwise."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InputError(f"{name} has shape {array.shape}, expected ({size},)")
    if not np.isfinite(array).all():
        raise InputError(f"{name} is not finite: {array}")
    return array


def rotation_from_quaternion(xyzw: ArrayLike, name: str = "orientation") -> Array:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w.

    Normalised when its norm is within ``ROTATION_TOLERANCE`` of 1; InputError beyond (zero too) or when not finite.
    """
    quaternion = vector(xyzw, 4, f"{name} quaternion")
    norm = float(np.sqrt(quaternion @ quaternion))
    if abs(norm - 1.0) > ROTATION_TOLERANCE:
        raise InputError(f"{name} quaternion has norm {norm:.6g}; accepted: 1 within {ROTATION_TOLERANCE}")
    x, y, z, w = (quaternion / norm).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(rotation: Array) -> Array:
    """Unit quaternion x, y, z, w of a rotation matrix (3, 3), with w >= 0."""
    # In Fortran's order: of other arrays eigenpy 3.13 makes a copy that it never frees, 80 bytes a call.
    coefficients: Array = pin.Quaternion(np.asfortranarray(rotation)).coeffs()
    return -coefficients if coefficients[3] < 0.0 else coefficients


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
    result = np.eye(4)
    rotation_t = pose[:3, :3].T
    result[:3, :3] = rotation_t
    result[:3, 3] = -(rotation_t @ pose[:3, 3])
    return result


def exp(twist: Array) -> Array:
    """Pose (4, 4) reached from the identity by following ``twist`` (v, omega) for one second."""
    result: Array = pin.exp6(pin.Motion(twist)).homogeneous
    return result


def log(pose: Array) -> Array:
    """The twist (v, omega) that leads from the identity to ``pose`` in one second; rotation angle in [0, pi].

    At exactly pi the axis has two signs, both right; one is chosen. Accurate to rounding near 0 and near pi.
    """
    result: Array = pin.log6(pin.SE3(pose)).vector
    return result


def exp_rotation(rotation_vector: Array) -> Array:
    """Rotation matrix (3, 3) about ``rotation_vector`` by its length in rad."""
    result: Array = pin.exp3(rotation_vector)
    return result


def log_rotation(rotation: Array) -> Array:
    """Rotation vector (3,) of ``rotation``, length in [0, pi]."""
    result: Array = pin.log3(rotation)
    return result


def adjoint(pose: Array) -> Array:
    """Ad(T_ab), (6, 6): turns a twist (v, omega) written in {b} into the same twist written in {a}."""
    result: Array = pin.SE3(pose).action
    return result


def angular_first(twist: Any) -> Array:
    """Swaps the halves along axis 0, (v, omega) <-> (omega, v), of a twist or wrench (6,) or a Jacobian (6, n)."""
    array = np.asarray(twist, dtype=np.float64)
    return np.concatenate((array[3:], array[:3]))

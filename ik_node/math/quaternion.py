"""Rotations as unit quaternions, and vectors of R^3, as tuples of floats for compiled code.

Tuples of floats stay in registers when compiled, and cost a tenth of a small array otherwise. Quaternions are
(w, x, y, z); rotation vectors are axis times angle, in rad. Poses as arrays are in :mod:`ik_node.math.se3`.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

import numpy as np

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.types import Array

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


@compiled
def length(a: Vector) -> float:
    """Euclidean norm."""
    x, y, z = a
    return sqrt(x * x + y * y + z * z)


@compiled
def difference(a: Vector, b: Vector) -> Vector:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def add(a: Vector, b: Vector) -> Vector:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@compiled
def scaled(a: Vector, factor: float) -> Vector:
    """factor a."""
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@compiled
def clamp_norm(a: Vector, max_norm: float) -> Vector:
    """``a``, shortened to ``max_norm`` if it is longer."""
    size = length(a)
    return a if size <= max_norm else scaled(a, max_norm / size)


@compiled
def dot(a: Vector, b: Vector) -> float:
    """a' b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@compiled
def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: the rotation ``b`` followed by ``a``, both about axes of the fixed frame."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@compiled
def conjugate(a: Quaternion) -> Quaternion:
    """The inverse rotation."""
    return (a[0], -a[1], -a[2], -a[3])


@compiled
def normalised(a: Quaternion) -> Quaternion:
    """``a`` at unit norm; without it rounding errors accumulate over an hour of control steps."""
    w, x, y, z = a
    scale = 1.0 / sqrt(w * w + x * x + y * y + z * z)
    return (w * scale, x * scale, y * scale, z * scale)


@compiled
def from_rotation_vector(rotation_vector: Vector) -> Quaternion:
    """Exponential map: the quaternion of a rotation vector, rad."""
    x, y, z = rotation_vector
    squared = x * x + y * y + z * z
    if squared < 1e-8:  # the series is exact to rounding here and does not divide by the angle
        factor = 0.5 - squared / 48.0
        return normalised((1.0 - squared / 8.0, x * factor, y * factor, z * factor))
    angle = sqrt(squared)
    factor = sin(0.5 * angle) / angle
    return (cos(0.5 * angle), x * factor, y * factor, z * factor)


@compiled
def to_rotation_vector(a: Quaternion) -> Vector:
    """Logarithmic map: the shortest rotation vector, length in [0, pi] rad; equal for q and -q."""
    w, x, y, z = a
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = sqrt(x * x + y * y + z * z)
    factor = 2.0 / w if sine < 1e-9 else 2.0 * atan2(sine, w) / sine
    return (x * factor, y * factor, z * factor)


def from_matrix(pose: Array) -> Quaternion:
    """Quaternion of a rotation matrix (3, 3), or of the rotation of a pose (4, 4), in any memory layout.

    Raises:
        InputError: The array has another shape.
    """
    matrix = np.ascontiguousarray(pose, dtype=np.float64)
    if matrix.shape not in ((4, 4), (3, 3)):
        raise InputError(f"rotation has shape {matrix.shape}, expected (4, 4) or (3, 3)")
    return pose_quaternion(matrix)


@compiled
def pose_quaternion(pose: Array) -> Quaternion:
    """:func:`from_matrix` of a C-contiguous array, compiled; divides by the largest component (Shepperd 1978)."""
    xx, xy, xz = pose[0, 0], pose[0, 1], pose[0, 2]
    yx, yy, yz = pose[1, 0], pose[1, 1], pose[1, 2]
    zx, zy, zz = pose[2, 0], pose[2, 1], pose[2, 2]
    trace = xx + yy + zz
    if trace >= max(xx, yy, zz):
        return normalised((1.0 + trace, zy - yz, xz - zx, yx - xy))
    if xx >= yy and xx >= zz:
        return normalised((zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx))
    if yy >= zz:
        return normalised((xz - zx, xy + yx, 1.0 + yy - xx - zz, yz + zy))
    return normalised((yx - xy, xz + zx, yz + zy, 1.0 + zz - xx - yy))


@compiled
def pose_position(pose: Array) -> Vector:
    """The position of a pose (4, 4)."""
    return (pose[0, 3], pose[1, 3], pose[2, 3])


@compiled
def rotate_inverse(a: Quaternion, v: Vector) -> Vector:
    """R' v: a vector of the fixed frame, expressed in the frame rotated by ``a``."""
    w, x, y, z = a
    # v + 2 w (v x u) + 2 u x (u x v), with u the vector part: R' v without forming R
    cx = v[1] * z - v[2] * y
    cy = v[2] * x - v[0] * z
    cz = v[0] * y - v[1] * x
    return (
        v[0] + 2.0 * (w * cx + cy * z - cz * y),
        v[1] + 2.0 * (w * cy + cz * x - cx * z),
        v[2] + 2.0 * (w * cz + cx * y - cy * x),
    )


@compiled
def rotate(a: Quaternion, v: Vector) -> Vector:
    """R v, with R the rotation matrix of ``a``."""
    return rotate_inverse(conjugate(a), v)


@compiled
def to_matrix(a: Quaternion) -> tuple[Vector, Vector, Vector]:
    """Rows of the rotation matrix of a unit quaternion."""
    w, x, y, z = a
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )

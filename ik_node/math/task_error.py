"""Error of a task with a tolerance: from the tool to the nearest member of the family of poses, with its derivative.

With Q = R_sb' R_sd, the rotation of the target seen from the tool, and c the six components of the deviation::

    linear part     c = A' (p_d - p_b) ,    A: the axes of the tolerance
    rotation part   none or three free components:   c = log Q
                    one free component, axis a:      Q = swing twist: c = log(swing) + twist a, the swing normal to a
                    two free components, axis a held: c_a = the least rotation to a pose without twist about a

In the frame ``base``, Q is R_sb R_sd' and the sign of c is reversed. The error is what exceeds the half-widths. The
part of a free component has no influence on the others; translation and rotation are separate, unlike in the logarithm
of SE(3), and unlike in its masked rotation part the swing does not depend on the twist.

The derivative, for body twists V_b of the tool and V_d of the target::

    c' = rows_d V_d - rows_b V_b

Where all components of the swing, or of log Q, are exact, the rows are those of the body twist: then this is the rate
in axes that move with the error along the shortest rotation. Its length has exactly this rate, and feedback of c
rotates the tool along the shortest way, whatever it does in the free direction. A rotation of linear axes is left out
likewise where it does not change the error.

The swing of half a turn has no unique direction: within :data:`HALF_TURN_CONE` of it, the direction that is passed in
is kept, so that noise does not reverse it.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    Quaternion,
    Vector,
    add,
    conjugate,
    cross,
    difference,
    dot,
    multiply,
    pose_position,
    pose_quaternion,
    to_matrix,
    to_rotation_vector,
)
from ik_node.math.so3 import inverse_coefficient
from ik_node.math.types import Array

LOG, SWING, TWIST = 0, 1, 2
"""How the rotation part is defined."""
TARGET_AXES, MEMBER_AXES, TOOL_AXES = 0, 1, 2
"""Axes of the linear part in the frame ``tool``: none or two, one, three free rotations."""
HALF_TURN_CONE = 0.01
"""Angle, rad, between a swing and half a turn within which its direction is kept."""
NO_DIRECTION: Vector = (0.0, 0.0, 0.0)
"""No swing direction to keep."""


class TaskForm(NamedTuple):
    """A tolerance for compiled functions; made by :attr:`ik_node.math.task_tolerance.TaskTolerance.form`."""

    half_widths: Array
    """(6,), m and rad; infinite for a free component."""
    in_base: bool
    """Whether the frame is ``base``."""
    rotation: int
    """LOG, SWING or TWIST."""
    axis: int
    """Axis of SWING or TWIST: 0, 1 or 2."""
    shortest: bool
    """Whether all components of the swing or logarithm are exact, so that the rows are those of the body twist."""
    linear_axes: int
    """TARGET_AXES, MEMBER_AXES or TOOL_AXES."""
    axes_turn: bool
    """Whether a rotation of the linear axes changes the error."""
    axes_spin: bool
    """Whether a rotation of the linear axes about ``axis`` changes the error."""


class TaskDeviation(NamedTuple):
    """Deviation of a tool from a target; the quantities of the module's equations."""

    components: Array
    """c, (6,), from the tool to the target, m and rad; of free components for information."""
    rows_b: Array
    """(6, 6): minus the derivative of c with respect to the body twist of the tool."""
    rows_d: Array
    """(6, 6): derivative of c with respect to the body twist of the target."""
    swing_direction: Vector
    """Unit vector of the swing, to be passed to the next call; NO_DIRECTION without a swing."""


@compiled
def excess(components: Array, half_widths: Array) -> Array:
    """What exceeds the half-widths, (6,): 0 for free components and inside a band; continuous at the border."""
    error = np.empty(6)
    for i in range(6):
        error[i] = components[i] - min(max(components[i], -half_widths[i]), half_widths[i])
    return error


@compiled
def task_deviation(
    form: TaskForm, pose_sb: Array, pose_sd: Array, swing_direction: Vector = NO_DIRECTION
) -> TaskDeviation:
    """Deviation of the tool from the target in the axes of the tolerance.

    Args:
        form: The tolerance.
        pose_sb: T_sb, (4, 4), C-contiguous: the tool in the base frame.
        pose_sd: T_sd, (4, 4), C-contiguous: the target in the base frame.
        swing_direction: That of the previous call where a target is followed; it is kept near half a turn.

    Returns:
        Components and their derivatives.
    """
    q_b, q_d = pose_quaternion(pose_sb), pose_quaternion(pose_sd)
    rotation_b, rotation_d = pose_sb[:3, :3].copy(), pose_sd[:3, :3].copy()
    q = multiply(q_b, conjugate(q_d)) if form.in_base else multiply(conjugate(q_b), q_d)
    turn, tool_rows, target_rows, direction = _rotation_part(form, q, swing_direction)
    components, rows_b, rows_d = np.zeros(6), np.zeros((6, 6)), np.zeros((6, 6))
    offset = difference(pose_position(pose_sd), pose_position(pose_sb))
    if form.in_base:
        components[:3], components[3:] = np.array(offset), -turn
        rows_b[:3, :3], rows_d[:3, :3] = rotation_b, rotation_d
        rows_b[3:, 3:] = _product(tool_rows, rotation_b)
        rows_d[3:, 3:] = _product(target_rows, rotation_b)
        return TaskDeviation(components, rows_b, rows_d, direction)
    relative = _matrix(q)
    axes, turn_b, turn_d = _linear_axes(form, q, rotation_b, rotation_d)
    inverse_axes = _transposed(axes)
    for i in range(3):
        components[i] = dot((axes[0, i], axes[1, i], axes[2, i]), offset)
    components[3:] = turn
    rows_b[:3, :3], rows_d[:3, :3] = _product(inverse_axes, rotation_b), _product(inverse_axes, rotation_d)
    if form.axes_turn:
        moved = _cross_matrix((components[0], components[1], components[2]))
        rows_b[:3, 3:] = -_product(moved, turn_b)
        rows_d[:3, 3:] = _product(moved, turn_d)
    rows_b[3:, 3:] = tool_rows
    rows_d[3:, 3:] = _product(target_rows, relative)
    return TaskDeviation(components, rows_b, rows_d, direction)


@compiled
def _rotation_part(form: TaskForm, q: Quaternion, kept: Vector) -> tuple[Array, Array, Array, Vector]:
    """c of the rotation Q, and the rows (3, 3) for the angular velocities of tool and target in tool axes."""
    if form.rotation == LOG:
        theta = to_rotation_vector(q)
        turn = np.array(theta)
        if form.shortest:
            return turn, np.eye(3), np.eye(3), NO_DIRECTION
        once = _cross_matrix(theta)
        rows = np.eye(3) - 0.5 * once + inverse_coefficient(dot(theta, theta)) * _product(once, once)
        return turn, rows, rows, NO_DIRECTION
    turn, tool_rows, target_rows, direction = _swing(form, q, kept)
    if form.rotation == TWIST:
        w, x, y, z = q
        if w < 0.0:
            w, x, y, z = -w, -x, -y, -z
        v, a = (x, y, z), _unit(form.axis)
        across = cross(v, a)
        size = sqrt(w * w + dot(across, across))
        turn[form.axis] = 2.0 * atan2(v[form.axis], size)
        for j in range(3):
            # half a turn about the axis itself: every direction normal to the quaternion is one; the axis is chosen
            row = (w * a[j] + across[j]) / size if size > 1e-9 else a[j]
            tool_rows[form.axis, j] = target_rows[form.axis, j] = row
    return turn, tool_rows, target_rows, direction


@compiled
def _swing(form: TaskForm, q: Quaternion, kept: Vector) -> tuple[Array, Array, Array, Vector]:
    """:func:`_rotation_part` by swing and twist about the axis."""
    w, v, a = q[0], (q[1], q[2], q[3]), _unit(form.axis)
    rotation = _matrix(q)
    u = (rotation[0, form.axis], rotation[1, form.axis], rotation[2, form.axis])
    twist = 2.0 * atan2(v[form.axis], w) if w >= 0.0 else 2.0 * atan2(-v[form.axis], -w)
    along = dot(a, u)
    normal = cross(a, u)
    sine = sqrt(dot(normal, normal))
    angle = atan2(sine, along)
    near_half_turn = along < 0.0 and sine < HALF_TURN_CONE
    if near_half_turn and dot(kept, kept) > 0.5:
        s = kept
    elif sine > 1e-12:
        s = (normal[0] / sine, normal[1] / sine, normal[2] / sine)
    else:
        s = _unit((form.axis + 1) % 3)
    n = cross(a, s)
    turn, tool_rows, target_rows = np.empty(3), np.zeros((3, 3)), np.zeros((3, 3))
    # Beside half a turn the exact rows grow without bound; within the cone they keep their value at its border.
    slope = max(sine, HALF_TURN_CONE) if near_half_turn else sine
    beside = angle * along / slope if angle > 1e-6 else 1.0
    for i in range(3):
        turn[i] = angle * s[i] + (twist if i == form.axis else 0.0)
        for j in range(3):
            if form.shortest:
                tool_rows[i, j] = 1.0 if i == j and i != form.axis else 0.0
                target_rows[i, j] = tool_rows[i, j] - (u[i] * u[j] if i != form.axis else 0.0)
            else:
                row = s[i] * s[j] + beside * n[i] * n[j] + angle * n[i] * a[j]
                tool_rows[i, j] = target_rows[i, j] = row
    for j in range(3):
        tool_rows[form.axis, j] = target_rows[form.axis, j] = (a[j] + u[j]) / _shared(along)
    return turn, tool_rows, target_rows, s


@compiled
def _linear_axes(form: TaskForm, q: Quaternion, rotation_b: Array, rotation_d: Array) -> tuple[Array, Array, Array]:
    """Axes (3, 3) of the linear part, and the maps of the angular velocities of tool and target to theirs."""
    if form.linear_axes == TARGET_AXES:
        return rotation_d, np.zeros((3, 3)), np.eye(3)
    if form.linear_axes == TOOL_AXES:
        return rotation_b, np.eye(3), np.zeros((3, 3))
    # The nearest member: the target turned back by the twist.
    a = _unit(form.axis)
    w, x = q[0], q[1 + form.axis]
    twist = 2.0 * atan2(x, w)
    half = 0.5 * twist
    spin = _matrix((cos(half), sin(half) * a[0], sin(half) * a[1], sin(half) * a[2]))
    axes = _product(rotation_d, _transposed(spin))
    turn_b, turn_d = np.zeros((3, 3)), spin.copy()
    turn_d[form.axis, :] = 0.0
    if form.axes_spin:
        relative = _matrix(q)
        u = (relative[0, form.axis], relative[1, form.axis], relative[2, form.axis])
        shared, scale = add(a, u), _shared(u[form.axis])
        for j in range(3):
            turn_b[form.axis, j] = shared[j] / scale
            turn_d[form.axis, j] = a[j] - dot((relative[0, j], relative[1, j], relative[2, j]), shared) / scale
    return axes, turn_b, turn_d


@compiled
def _shared(along: float) -> float:
    """1 + a' u, bounded below by its value at the border of the cone about half a turn."""
    return max(1.0 + along, 0.5 * HALF_TURN_CONE * HALF_TURN_CONE)


@compiled
def _unit(axis: int) -> Vector:
    return (1.0 if axis == 0 else 0.0, 1.0 if axis == 1 else 0.0, 1.0 if axis == 2 else 0.0)


@compiled
def _matrix(q: Quaternion) -> Array:
    rows = to_matrix(q)
    matrix = np.empty((3, 3))
    for i in range(3):
        matrix[i, 0], matrix[i, 1], matrix[i, 2] = rows[i]
    return matrix


@compiled
def _product(a: Array, b: Array) -> Array:
    """a b, (3, 3); sums in fixed order, unlike BLAS."""
    result = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            result[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return result


@compiled
def _transposed(a: Array) -> Array:
    return np.array(((a[0, 0], a[1, 0], a[2, 0]), (a[0, 1], a[1, 1], a[2, 1]), (a[0, 2], a[1, 2], a[2, 2])))


@compiled
def _cross_matrix(v: Vector) -> Array:
    """[v]: [v] w = v x w."""
    return np.array(((0.0, -v[2], v[1]), (v[2], 0.0, -v[0]), (-v[1], v[0], 0.0)))

"""The member of a target that stands for its family: the one nearest to a reference, whatever the target's free part.

A target with a tolerance stands for a family of poses (:mod:`ik_node.math.task_error`). Targets of the same family have
to give the same commands, also where they pass a filter that knows nothing of tolerances. So each target is replaced
by the member of its family that is nearest to a reference: the previous target, or at first the tool. The member is a
function of the family and the reference alone.

Free are, as far as they are the same for all members of a family:

- all three rotations, or the one about an axis a of the target (frame ``tool``) or of {s} (``base``);
- translations along axes that all members share: in ``base`` all, in ``tool`` those of a target without free rotation,
  or with two; with one free rotation about a, the translation along a, and the two others only together.

Two free rotations leave no two targets with the same family; there the orientation is left as it is.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import (
    ZERO,
    Quaternion,
    Vector,
    add,
    cross,
    difference,
    dot,
    multiply,
    normalised,
    rotate,
    rotate_inverse,
    scaled,
)
from ik_node.math.task_error import MEMBER_AXES, SWING, TARGET_AXES, TaskForm

NEAR_HALF_TURN = 1e-3
"""Sine of a swing beside half a turn below which its direction is chosen, because rounding would decide it."""


@compiled
def nearest_member(
    form: TaskForm, position: Vector, orientation: Quaternion, near_position: Vector, near_orientation: Quaternion
) -> tuple[Vector, Quaternion]:
    """The member of a target's family that is nearest to a reference.

    Args:
        form: The tolerance.
        position: Of the target, m, in {s}.
        orientation: R_sd, (w, x, y, z).
        near_position: Of the reference.
        near_orientation: Of the reference.

    Returns:
        Position and orientation of the member.
    """
    turned = orientation
    free = _free_rotations(form)
    if free == 3:
        turned = near_orientation
    elif free == 1 and form.rotation == SWING:
        a = _axis(form.axis)
        if form.in_base:
            # R' a of the target is the same for all members: the axis of {s} in their own axes.
            seen = rotate(near_orientation, rotate_inverse(orientation, a))
            turned = normalised(multiply(_swing(seen, a), near_orientation))
        else:
            seen = rotate_inverse(near_orientation, rotate(orientation, a))
            turned = normalised(multiply(near_orientation, _swing(a, seen)))
    return add(position, _along_free(form, orientation, difference(near_position, position))), turned


@compiled
def without_free_part(form: TaskForm, orientation: Quaternion, velocity: Vector, rate: Vector) -> tuple[Vector, Vector]:
    """A velocity and an angular velocity of a target in {s} without what is free.

    Args:
        form: The tolerance.
        orientation: R_sd, (w, x, y, z).
        velocity: Of the target's origin, m/s.
        rate: rad/s.

    Returns:
        Both, with the free part zero.
    """
    free = _free_rotations(form)
    a = _axis(form.axis) if form.in_base else rotate(orientation, _axis(form.axis))
    if free == 3:
        rate = ZERO
    elif free == 2:
        rate = scaled(a, dot(a, rate))
    elif free == 1 and form.rotation == SWING:
        rate = difference(rate, scaled(a, dot(a, rate)))
    return difference(velocity, _along_free(form, orientation, velocity)), rate


@compiled
def _free_rotations(form: TaskForm) -> int:
    count = 0
    for index in range(3, 6):
        count += 1 if np.isinf(form.half_widths[index]) else 0
    return count


@compiled
def _along_free(form: TaskForm, orientation: Quaternion, vector: Vector) -> Vector:
    """The part of a vector in {s} along free translations that all members of the family share."""
    widths, along = form.half_widths, ZERO
    for index in range(3):
        if not np.isinf(widths[index]):
            continue
        axis = _axis(index)
        if not form.in_base:
            others = np.isinf(widths[(form.axis + 1) % 3]) and np.isinf(widths[(form.axis + 2) % 3])
            if form.linear_axes == MEMBER_AXES:
                if index != form.axis and not others:
                    continue
            elif form.linear_axes != TARGET_AXES:
                continue
            axis = rotate(orientation, axis)
        along = add(along, scaled(axis, dot(axis, vector)))
    return along


@compiled
def _swing(a: Vector, b: Vector) -> Quaternion:
    """The least rotation that brings the unit vector a onto b; beside half a turn, one of a fixed direction first."""
    along, normal = dot(a, b), cross(a, b)
    sine = sqrt(dot(normal, normal))
    if along > 0.0 or sine > NEAR_HALF_TURN:
        # half the angle, of which the cosine does not cancel: 1 + cos = 2 cos^2
        w = sqrt(0.5 * (1.0 + along)) if along > 0.0 else sine / sqrt(2.0 * (1.0 - along))
        return normalised((w, normal[0] / (2.0 * w), normal[1] / (2.0 * w), normal[2] / (2.0 * w)))
    x, y, z = abs(a[0]), abs(a[1]), abs(a[2])
    least = _axis(0) if x <= y and x <= z else _axis(1) if y <= z else _axis(2)
    across = cross(a, least)
    s = scaled(across, 1.0 / sqrt(dot(across, across)))
    return normalised(multiply(_swing_small(scaled(a, -1.0), b), (0.0, s[0], s[1], s[2])))


@compiled
def _swing_small(a: Vector, b: Vector) -> Quaternion:
    """:func:`_swing` for vectors that are close to each other."""
    normal = cross(a, b)
    w = sqrt(0.5 * (1.0 + dot(a, b)))
    return normalised((w, normal[0] / (2.0 * w), normal[1] / (2.0 * w), normal[2] / (2.0 * w)))


@compiled
def _axis(index: int) -> Vector:
    return (1.0 if index == 0 else 0.0, 1.0 if index == 1 else 0.0, 1.0 if index == 2 else 0.0)

"""Position limits seen in time: bounds at which joints near their position limits can still stop along the direction.

The box of one control step (:mod:`ik_node.robot.joint_limits`) lets a joint approach its position limit until it has to
brake with all of its acceleration. Along the direction of V the other joints brake as well, in proportion to the joint
velocities p that V requires and to the null space n, and their accelerations may not permit it::

    qd = s p + w n ,   lo <= qd <= hi ,   0 <= s <= 1

With d_i = qd_i^2 / (2 room_i), the deceleration with which joint i stops just at its limit, the greatest k is found at
which every joint near a limit decelerates by k d_i at once. Their bounds are those of the deceleration c k d_i instead
of a_i, c < 1: they begin to brake while it is possible along the direction, and the null space evades in time. Joints
that approach their limits from farther away accelerate less the nearer they are, so that they do not spend, as means
of this evasion, what they need to stop themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.viable_scale import ACCELERATION_FRACTION, MIN_RATE
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, viable_speed_at

NEAR, NEAR_WITH_NULL_SPACE = 0.2, 0.5
"""A joint is near its position limit if it has to brake with more than this fraction of its acceleration. A null space
can evade later; with the first value it was spent too early, and an xArm 7 came to rest at a limit."""

ROUNDING = 1e-9
"""Accuracy of the joint velocities, rad/s (m/s), and of the corners."""


@compiled
def viable_bounds(
    bounds: JointBounds, p: Array, null: Array, q: Array, previous: Array, limits: MotionLimits, elapsed_s: float
) -> JointBounds:
    """``bounds`` with the narrower position bounds; themselves while no joint is near a limit.

    Args:
        bounds: Limits of this control step.
        p: Joint velocities that the twist requires, (n,).
        null: Basis of the null space, (d, n); for d > 1 there are no narrower bounds.
        q: Joint positions, (n,), rad (m).
        previous: The present command, (n,), rad/s (m/s).
        limits: Limits of the joints.
        elapsed_s: For how long it has been held, s.
    """
    n, count = len(q), 0
    joints, braking = np.empty(n, dtype=np.int64), np.empty(n)
    lo, hi = bounds.lo.copy(), bounds.hi.copy()
    held_s, tick = min(max(elapsed_s, 0.0), limits.dt_max_s), limits.dt_max_s
    near = NEAR if len(null) == 0 else NEAR_WITH_NULL_SPACE
    if len(null) > 1 or held_s == 0.0:
        return bounds
    for i in range(n):
        room = limits.upper[i] - q[i] if previous[i] > 0.0 else q[i] - limits.lower[i]
        if room <= 0.0 or previous[i] == 0.0:
            continue
        needed = 0.5 * previous[i] * previous[i] / room
        if needed > near * limits.acceleration[i]:
            joints[count], braking[count] = i, needed
            count += 1
        else:
            change = held_s * (limits.acceleration[i] - needed / near)
            _narrow(lo, hi, i, previous[i], abs(previous[i]) + change)
    if count == 0:
        return bounds
    ratio = braking_ratio(p, null, lo, hi, previous, joints[:count], held_s * braking[:count])
    if ratio <= 0.0:
        return bounds
    position_lo, position_hi = bounds.position_lo.copy(), bounds.position_hi.copy()
    for k in range(count):
        i, needed = joints[k], ACCELERATION_FRACTION * ratio * braking[k]
        room = limits.upper[i] - q[i] if previous[i] > 0.0 else q[i] - limits.lower[i]
        speed = max(viable_speed_at(room, needed, tick, tick), abs(previous[i]) - held_s * needed)
        _narrow(lo, hi, i, previous[i], speed)
    for i in range(n):
        if lo[i] > bounds.lo[i]:
            position_lo[i] = lo[i]
        if hi[i] < bounds.hi[i]:
            position_hi[i] = hi[i]
    return JointBounds(lo, hi, bounds.velocity, bounds.reach_lo, bounds.reach_hi, position_lo, position_hi)


@compiled
def _narrow(lo: Array, hi: Array, joint: int, previous: float, speed: float) -> None:
    """Bounds the speed of a joint in its present direction, within ``lo`` and ``hi``."""
    if previous > 0.0:
        hi[joint] = max(min(hi[joint], speed), lo[joint])
    else:
        lo[joint] = min(max(lo[joint], -speed), hi[joint])


@compiled
def braking_ratio(
    p: Array, null: Array, lo: Array, hi: Array, previous: Array, joints: NDArray[np.int64], changes: Array
) -> float:
    """The greatest k at which the speeds of all ``joints`` fall by k times ``changes`` along the direction; or 0.

    A linear program in s and w, solved by its corners.

    Args:
        p: Joint velocities that the twist requires, (n,).
        null: Basis of the null space, (0 or 1, n).
        lo: Smallest joint velocities, (n,), rad/s (m/s).
        hi: Greatest ones, (n,).
        previous: The present command, (n,).
        joints: Indices of the joints that have to brake, (k,).
        changes: (k,), > 0, rad/s (m/s).
    """
    n, count = len(p), len(joints)
    size = np.abs(p).max()
    if size < MIN_RATE:
        return 0.0
    rows = np.zeros((n, 2))  # qd = rows (s size, w)
    for i in range(n):
        rows[i, 0] = p[i] / size
        if len(null):
            rows[i, 1] = null[0, i]
    gains = np.empty((count, 3))  # k = min(gains (s size, w, 1))
    for k in range(count):
        i = joints[k]
        gains[k, :2] = -np.sign(previous[i]) / changes[k] * rows[i]
        gains[k, 2] = abs(previous[i]) / changes[k]
    lines = np.zeros((2 * n + 3 + count * (count - 1) // 2, 3))  # lines (s size, w, 1) = 0
    for i in range(n):
        lines[i, :2], lines[i, 2] = rows[i], -hi[i]
        lines[n + i, :2], lines[n + i, 2] = rows[i], -lo[i]
    row = 2 * n + 3
    lines[row - 3, 0], lines[row - 2, 0], lines[row - 2, 2], lines[row - 1, 1] = 1.0, 1.0, -size, 1.0
    for k in range(count):
        for other in range(k):
            lines[row] = gains[k] - gains[other]
            row += 1
    best = 0.0
    for first in range(len(lines)):
        for second in range(first):
            a, b, c, d = lines[first, 0], lines[first, 1], lines[second, 0], lines[second, 1]
            determinant = a * d - b * c
            if abs(determinant) <= ROUNDING * (abs(a * d) + abs(b * c)):
                continue
            e, f = -lines[first, 2], -lines[second, 2]
            s, w = (e * d - b * f) / determinant, (a * f - e * c) / determinant
            ratio = np.inf
            for k in range(count):
                ratio = min(ratio, gains[k, 0] * s + gains[k, 1] * w + gains[k, 2])
            if ratio > best and -ROUNDING <= s <= size + ROUNDING and _is_inside(rows, s, w, lo, hi):
                best = ratio
    return best


@compiled
def _is_inside(rows: Array, s: float, w: float, lo: Array, hi: Array) -> bool:
    for i in range(len(rows)):  # noqa: SIM110 - numba does not compile all() of a generator
        if not lo[i] - ROUNDING <= rows[i, 0] * s + rows[i, 1] * w <= hi[i] + ROUNDING:
            return False
    return True

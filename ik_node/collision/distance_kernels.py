"""Compiled functions on pairs of solids: bounds of the approach speed, pairs to compute, gradients of distances.

Solids are indexed: first the links of the arm, then the obstacles. All vectors are expressed in the root frame of the
model. ``firsts`` and ``seconds`` (pairs,) are the indices of the solids of a pair; ``moves`` (solids, m) is 1 where a
moving joint moves a solid; ``reach`` (pairs, n) bounds the change of a distance per joint motion, m per rad (1 for m).

The state of the distance computation consists of four arrays: ``bound`` (pairs,), m, a lower bound of each distance;
``fresh`` (pairs,), True where the bound is the distance at the present q; and, valid where fresh, ``normals``
(pairs, 3), unit vectors from the first to the second solid, and ``points`` (pairs, 2, 3), m, the nearest points.

The arrays are separate arguments because packing them into a NamedTuple takes longer than these functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.types import Array

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

MAX_DISTANCE_M = 1e6
"""A result of a larger magnitude, m, is not a valid distance."""

ALL_MEASURED, NO_PAIR_NEAR = -1, -2
"""Values returned instead of the index of a pair; see :func:`next_pair`."""

UNIT_TOLERANCE = 1e-3
"""Largest deviation of the squared norm of a normal from 1."""


class NearPairs(NamedTuple):
    """The k pairs within the requested range, in ascending order of their indices."""

    pair: Indices
    """Indices of the pairs, (k,); see :meth:`ik_node.collision.distances.DistanceQuery.names`."""
    distance: Array
    """(k,), m; negative in penetration."""
    slope: Array
    """d(distance)/dq, (k, n), m per rad (m)."""
    drift: Array
    """Rates of the distances due to the motion of the obstacles, (k,), m/s; negative towards the arm."""
    self_collision: Array
    """1 for pairs of links, 0 for pairs of link and obstacle, (k,)."""


@compiled
def store_obstacle_motion(
    new_pose: Array,
    old_pose: Array,
    velocity: Array,
    spin: Array,
    reach: float,
    root_base: Array,
    obstacle: int,
    speeds: Array,
    motions: Array,
) -> float:
    """Stores the motion of an obstacle; returns the largest displacement of its points since the old pose, m.

    ``new_pose``, ``old_pose`` (4, 4), ``velocity``, ``spin`` (3,) are expressed in the base frame; ``root_base`` (4, 4)
    is its pose in the root frame. ``reach``: largest distance of a point from the obstacle's origin, m. Written are
    ``speeds`` (obstacles,), upper bounds of the speeds of all points, m/s, and ``motions`` (obstacles, 3, 3): velocity,
    angular velocity and origin in the root frame.
    """
    speeds[obstacle] = _norm(velocity) + _norm(spin) * reach
    for axis in range(3):
        row = root_base[axis]
        motions[obstacle, 0, axis] = row[0] * velocity[0] + row[1] * velocity[1] + row[2] * velocity[2]
        motions[obstacle, 1, axis] = row[0] * spin[0] + row[1] * spin[1] + row[2] * spin[2]
        place = row[0] * new_pose[0, 3] + row[1] * new_pose[1, 3] + row[2] * new_pose[2, 3]
        motions[obstacle, 2, axis] = place + row[3]
    turned = moved = 0.0
    for row_number in range(3):
        for column in range(3):
            turned += (new_pose[row_number, column] - old_pose[row_number, column]) ** 2
        moved += (new_pose[row_number, 3] - old_pose[row_number, 3]) ** 2
    return float(np.sqrt(moved) + np.sqrt(turned) * reach)


@compiled
def _norm(vector: Array) -> float:
    return float(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]))


@compiled
def decrease_bounds_of_solid(solid: int, motion: float, seconds: Indices, bound: Array) -> None:
    """Decreases the bounds of the pairs whose second solid is ``solid``, which has moved by ``motion``, m."""
    for pair in range(len(bound)):
        if seconds[pair] == solid:
            bound[pair] -= motion


@compiled
def approach_speed_bounds(
    motion: Array,
    change: Array,
    jacobian: Array,
    moves: Array,
    centres: Array,
    radii: Array,
    obstacle_speeds: Array,
    firsts: Indices,
    seconds: Indices,
    reach: Array,
) -> Array:
    """Upper bounds of the rates at which the distances can decrease.

    Args:
        motion: Velocities of the moving joints, (m,), rad/s (m/s).
        change: Largest difference of the velocities of the controlled joints from those, (n,), rad/s (m/s).
        jacobian: Twists per joint velocity, (m, 6), linear part first, in the root frame.
        moves: 1 where a joint moves a link, (links, m).
        centres: Centres of the links' bounding spheres, (links, 3), m.
        radii: Their radii, (links,), m.
        obstacle_speeds: Upper bounds of the obstacles' speeds, (obstacles,), m/s.
        firsts: Index of the first solid of each pair, (pairs,).
        seconds: Index of the second solid of each pair, (pairs,).
        reach: Bound of the change of distance per joint motion, (pairs, n), m per rad (1 for m).

    Returns:
        The bounds, (pairs,), m/s.
    """
    links, twist = len(radii), np.empty(6)
    fastest = np.empty(links + len(obstacle_speeds))
    fastest[links:] = obstacle_speeds
    for link in range(links):
        twist[:] = 0.0
        for joint in range(len(motion)):
            if moves[link, joint] != 0.0:
                for row in range(6):
                    twist[row] += motion[joint] * jacobian[joint, row]
        spin, x, y, z = twist[3:], centres[link, 0], centres[link, 1], centres[link, 2]
        vx = twist[0] + (spin[1] * z - spin[2] * y)
        vy = twist[1] + (spin[2] * x - spin[0] * z)
        vz = twist[2] + (spin[0] * y - spin[1] * x)
        fastest[link] = np.sqrt(vx * vx + vy * vy + vz * vz) + _norm(spin) * radii[link]
    speeds = np.empty(len(firsts))
    for pair in range(len(firsts)):
        changed = 0.0
        for joint in range(len(change)):
            changed += reach[pair, joint] * change[joint]
        speeds[pair] = fastest[firsts[pair]] + fastest[seconds[pair]] + changed
    return speeds


@compiled
def decrease_bounds(motion: Array, reach: Array, bound: Array, fresh: Flags, within: Array, closest: bool) -> int:
    """Decreases the bounds by a motion of the controlled joints, (n,), and marks all pairs as not fresh; returns the
    first pair to compute, see :func:`next_pair`."""
    for pair in range(len(bound)):
        moved = 0.0
        for joint in range(len(motion)):
            moved += reach[pair, joint] * abs(motion[joint])
        bound[pair] -= moved
        fresh[pair] = False
    return next_pair(bound, fresh, within, closest)


@compiled
def next_pair(bound: Array, fresh: Flags, within: Array, closest: bool) -> int:
    """Index of the next pair whose distance must be computed.

    These are the pairs whose bound is below ``within`` (pairs,), m, and then, with ``closest``, the pairs that may be
    nearer than the closest one found so far. When none is left, returns :data:`ALL_MEASURED`, or :data:`NO_PAIR_NEAR`
    if no computed pair is nearer than ``within``.
    """
    left = NO_PAIR_NEAR
    for pair in range(len(bound)):
        # NaN counts as near.
        if not bound[pair] >= within[pair]:
            if not fresh[pair]:
                return pair
            left = ALL_MEASURED
    if closest:
        nearest = int(np.argmin(bound))
        if not fresh[nearest]:
            return nearest
    return left


@compiled
def store_measurement(
    pair: int,
    distance: float,
    normal: Array,
    first: Array,
    second: Array,
    origins: Array,
    firsts: Indices,
    seconds: Indices,
    bound: Array,
    fresh: Flags,
    normals: Array,
    points: Array,
    within: Array,
    closest: bool,
) -> int:
    """Stores the distance of a pair; returns the next pair to compute, see :func:`next_pair`.

    ``normal``, ``first``, ``second`` (3,): direction and nearest points. ``origins`` (solids, 3), m: of the solids.
    """
    square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]
    if abs(distance) < MAX_DISTANCE_M and abs(square - 1.0) < UNIT_TOLERANCE:
        bound[pair], normals[pair], points[pair, 0], points[pair, 1] = distance, normal, first, second
    else:
        # EPA can fail in deep penetration. Then the distance is 0 and the normal points from origin to origin.
        start, end = origins[firsts[pair]], origins[seconds[pair]]
        apart = end - start
        bound[pair], normals[pair] = 0.0, apart / np.maximum(_norm(apart), 1e-9)
        points[pair, 0], points[pair, 1] = start, end
    fresh[pair] = True
    return next_pair(bound, fresh, within, closest)


@compiled
def collect_near_pairs(
    within: Array,
    jacobian: Array,
    ratio: Array,
    moves: Array,
    obstacle_motions: Array,
    firsts: Indices,
    seconds: Indices,
    bound: Array,
    fresh: Flags,
    normals: Array,
    points: Array,
    pairs: Indices,
    distance: Array,
    slope: Array,
    drift: Array,
    own: Array,
) -> int:
    """Writes the pairs nearer than ``within`` (pairs,) into the first rows of the arrays of a :class:`NearPairs`
    (``pairs`` to ``own``); returns their number.

    ``jacobian`` (m, 6): twists per joint velocity. ``ratio`` (m, n): motion of the moving joints per controlled joint.
    ``obstacle_motions`` (obstacles, 3, 3): see :func:`store_obstacle_motion`.
    """
    m, n = ratio.shape
    links, row = len(moves) - len(obstacle_motions), 0
    for pair in range(len(bound)):
        if not fresh[pair] or bound[pair] >= within[pair]:
            continue
        pairs[row], distance[row] = pair, bound[pair]
        normal, first, second = normals[pair], points[pair, 0], points[pair, 1]
        slope[row] = 0.0
        for joint in range(m):
            twist = jacobian[joint]
            towards = moves[seconds[pair], joint] * _speed_along(normal, second, twist)
            towards -= moves[firsts[pair], joint] * _speed_along(normal, first, twist)
            for controlled in range(n):
                slope[row, controlled] += towards * ratio[joint, controlled]
        if seconds[pair] < links:
            own[row], drift[row] = 1.0, 0.0
        else:
            own[row], drift[row] = 0.0, _drift(normal, second, obstacle_motions[seconds[pair] - links])
        row += 1
    return row


@compiled
def _speed_along(normal: Array, point: Array, twist: Array) -> float:
    """Speed of a point p along n under a twist (v, w): n.v + (p x n).w ."""
    speed = normal[0] * twist[0] + normal[1] * twist[1] + normal[2] * twist[2]
    speed += (point[1] * normal[2] - point[2] * normal[1]) * twist[3]
    speed += (point[2] * normal[0] - point[0] * normal[2]) * twist[4]
    return float(speed + (point[0] * normal[1] - point[1] * normal[0]) * twist[5])


@compiled
def _drift(normal: Array, point: Array, motion: Array) -> float:
    """Speed of a point of an obstacle along the normal; ``motion`` (3, 3): see :func:`store_obstacle_motion`."""
    velocity, spin, lever = motion[0], motion[1], point - motion[2]
    drift = normal[0] * (velocity[0] + (spin[1] * lever[2] - spin[2] * lever[1]))
    drift += normal[1] * (velocity[1] + (spin[2] * lever[0] - spin[0] * lever[2]))
    return float(drift + normal[2] * (velocity[2] + (spin[0] * lever[1] - spin[1] * lever[0])))


@compiled
def closest_pair(bound: Array, points: Array, pose: Array) -> tuple[int, float, Array]:
    """Closest pair, its distance, and its nearest points (2, 3) in the base frame; ``pose`` (4, 4): the root."""
    pair = int(np.argmin(bound))
    nearest = np.empty((2, 3))
    for end in range(2):
        x, y, z = points[pair, end, 0], points[pair, end, 1], points[pair, end, 2]
        for axis in range(3):
            nearest[end, axis] = x * pose[axis, 0] + y * pose[axis, 1] + z * pose[axis, 2] + pose[axis, 3]
    return pair, float(bound[pair]), nearest

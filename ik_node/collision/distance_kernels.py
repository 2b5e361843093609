"""Compiled functions on the computed distances of pairs: their storage, and the gradients of those that are near.

Solids, pairs and arrays are those of :mod:`.distance_bounds`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.collision.closest_pair import next_closest
from ik_node.collision.distance_bounds import Indices
from ik_node.jit import compiled
from ik_node.math.types import Array

MAX_DISTANCE_M = 1e6
"""A result of a larger magnitude, m, is not a valid distance."""

UNIT_TOLERANCE = 1e-3
"""Largest deviation of the squared norm of a normal from 1."""

DISTANCE, NORMAL, FIRST, SECOND = 0, 1, 4, 7
"""Columns of the results of :class:`ik_node.collision.convex_distances.ConvexDistances`."""

FIRST_GUESS = (1.0, 0.0, 0.0, 0.0)
"""Direction from which GJK starts, and the bits of the two corners from which it starts, both 0."""

NOT_COMPUTED = float(np.finfo(np.float64).max)
"""Distance of a result before its computation: coal keeps the smaller one."""


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
def store_distances(
    begin: int,
    end: int,
    results: Array,
    guesses: Array,
    listed: Indices,
    places: Array,
    obstacle_places: Array,
    travel: Array,
    obstacle_travel: Array,
    key: Array,
    tick: int,
    computed: Indices,
    distances: Array,
    normals: Array,
    points: Array,
    count: int,
    total: int,
    closest: bool,
    capsules: Array,
    firsts: Indices,
    seconds: Indices,
    links: Indices,
    obstacle_capsules: Array,
    level: Array,
    closed: Indices,
) -> tuple[int, int]:
    """Stores the computed distances of the rows ``begin`` to ``end`` of ``listed``.

    With ``closest``, adds a pair that may be nearer than all computed ones to ``listed``.

    Args:
        begin: First row.
        end: Row behind the last one.
        results: Distance, normal, and nearest points of each row, see :data:`DISTANCE`; made ready for the next ones.
        guesses: Written: :data:`FIRST_GUESS`. coal would start from the end of the last computation, which changes the
            last digits (up to 1e-6 m).
        listed: Pairs and their solids, (pairs, 3).
        places: Places of the links, (links, 12).
        obstacle_places: Places of the obstacles, (obstacles, 12).
        travel: Travel of the links, (links + 1,), m.
        obstacle_travel: Travel of the obstacles, (obstacles,), m.
        key: Updated: bounds, (pairs,), m.
        tick: Number of this query.
        computed: Written: number of the query in which a pair was computed last, (pairs,).
        distances: Written: (pairs,), m.
        normals: Written: unit vectors from the first to the second solid, (pairs, 3).
        points: Written: nearest points, (pairs, 2, 3), m.
        count: Number of near pairs to be computed.
        total: Number of near pairs; those between have the distances of their capsules.
        closest: False when the closest pair is not wanted.
        capsules: Bounding capsules of the links, (links, 7).
        firsts: First link of each pair of links, (P,).
        seconds: Second link of each pair of links, (P,).
        links: Links that are paired with obstacles.
        obstacle_capsules: Bounding capsules of the obstacles, (obstacles, 7).
        level: Updated: bounds of the obstacles, (obstacles,), m.
        closed: Updated: number of the query in which no further pair of an obstacle can be the closest, (obstacles,).

    Returns:
        The number of listed pairs, and the row of the closest computed pair, of equal ones that with the lowest index;
        -1 for none.
    """
    links_count = len(places)
    for row in range(begin, end):
        pair, first, second = listed[row]
        found = results[row]
        square = 0.0
        for axis in range(3):
            square += found[NORMAL + axis] * found[NORMAL + axis]
        if abs(found[DISTANCE]) < MAX_DISTANCE_M and abs(square - 1.0) < UNIT_TOLERANCE:
            distances[row] = found[DISTANCE]
            for axis in range(3):
                normals[row, axis] = found[NORMAL + axis]
                points[row, 0, axis], points[row, 1, axis] = found[FIRST + axis], found[SECOND + axis]
        else:
            # EPA can fail in deep penetration. Then the distance is 0 and the normal points from origin to origin.
            start = places[first, 9:]
            stop = places[second, 9:] if second < links_count else obstacle_places[second - links_count, 9:]
            apart = stop - start
            distances[row], normals[row] = 0.0, apart / np.maximum(_norm(apart), 1e-9)
            points[row, 0], points[row, 1] = start, stop
        gone = travel[second] if second < links_count else obstacle_travel[second - links_count]
        key[pair] = distances[row] + travel[first] + gone
        computed[pair] = tick
        found[DISTANCE] = NOT_COMPUTED
        for number in range(4):
            guesses[row, number] = FIRST_GUESS[number]
    best = -1
    for row in range(end):
        if count <= row < total:
            continue
        is_first = best < 0 or listed[row, 0] < listed[best, 0]
        if best < 0 or distances[row] < distances[best] or (is_first and distances[row] == distances[best]):
            best = row
    end = max(end, total)
    if closest:
        nearest = distances[best] if best >= 0 else np.inf
        end = next_closest(
            end,
            nearest,
            tick,
            capsules,
            firsts,
            seconds,
            links,
            obstacle_capsules,
            travel,
            obstacle_travel,
            key,
            level,
            computed,
            closed,
            listed,
        )
    return end, best


@compiled
def collect_near_pairs(
    count: int,
    listed: Indices,
    within: Array,
    jacobian: Array,
    ratio: Array,
    moves: Array,
    motions: Array,
    distances: Array,
    normals: Array,
    points: Array,
    pairs: Indices,
    distance: Array,
    slope: Array,
    drift: Array,
    own: Array,
) -> int:
    """Writes those of the first ``count`` listed pairs that are nearer than ``within`` (pairs,) into the first rows of
    the arrays of a :class:`NearPairs` (``pairs`` to ``own``); returns their number.

    ``jacobian`` (m, 6): twists per joint velocity. ``ratio`` (m, n): motion of the moving joints per controlled joint.
    ``motions`` (obstacles, 3, 3): velocity, angular velocity and origin, see :func:`place_obstacles`.
    """
    m, n = ratio.shape
    links, row = len(moves), 0
    for number in range(count):
        if distances[number] >= within[number]:
            continue
        pair, first, second = listed[number]
        pairs[row], distance[row] = pair, distances[number]
        normal, start, end = normals[number], points[number, 0], points[number, 1]
        slope[row] = 0.0
        for joint in range(m):
            twist = jacobian[joint]
            towards = 0.0
            if second < links:
                towards += moves[second, joint] * _speed_along(normal, end, twist)
            towards -= moves[first, joint] * _speed_along(normal, start, twist)
            for controlled in range(n):
                slope[row, controlled] += towards * ratio[joint, controlled]
        if second < links:
            own[row], drift[row] = 1.0, 0.0
        else:
            own[row], drift[row] = 0.0, _drift(normal, end, motions[second - links])
        row += 1
    return row


@compiled
def _norm(vector: Array) -> float:
    return float(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]))


@compiled
def _speed_along(normal: Array, point: Array, twist: Array) -> float:
    """Speed of a point p along n under a twist (v, w): n.v + (p x n).w ."""
    speed = normal[0] * twist[0] + normal[1] * twist[1] + normal[2] * twist[2]
    speed += (point[1] * normal[2] - point[2] * normal[1]) * twist[3]
    speed += (point[2] * normal[0] - point[0] * normal[2]) * twist[4]
    return float(speed + (point[0] * normal[1] - point[1] * normal[0]) * twist[5])


@compiled
def _drift(normal: Array, point: Array, motion: Array) -> float:
    """Speed of a point of an obstacle along the normal; ``motion`` (3, 3): velocity, angular velocity and origin."""
    velocity, spin, lever = motion[0], motion[1], point - motion[2]
    drift = normal[0] * (velocity[0] + (spin[1] * lever[2] - spin[2] * lever[1]))
    drift += normal[1] * (velocity[1] + (spin[2] * lever[0] - spin[0] * lever[2]))
    return float(drift + normal[2] * (velocity[2] + (spin[0] * lever[1] - spin[1] * lever[0])))


@compiled
def in_base(points: Array, pose: Array) -> Array:
    """Points (2, 3) in the base frame; ``pose`` (4, 4): the root frame in the base frame."""
    placed = np.empty((2, 3))
    for end in range(2):
        x, y, z = points[end, 0], points[end, 1], points[end, 2]
        for axis in range(3):
            placed[end, axis] = x * pose[axis, 0] + y * pose[axis, 1] + z * pose[axis, 2] + pose[axis, 3]
    return placed

"""Pairs of solids at one tick: how fast they can approach, which to measure, how their distances change.

Solids are numbered: the arm's links, then the obstacles. Everything is seen from the model's root. ``firsts``,
``seconds`` (pairs,) are the numbers of a pair's solids, ``moves`` (solids, m) is 1 where a moving joint moves a solid,
``reach`` (pairs, n) says how far a joint's motion can change a distance at most, m per rad (1 for m).

What is known of distances is kept in four arrays: ``bound`` (pairs,), m, no pair is nearer than that; ``fresh``
(pairs,): the bound is the distance, measured at this q; for these ``normals`` (pairs, 3), unit vectors from the first
to the second solid, and ``points`` (pairs, 2, 3), m, the nearest points on both.

Arrays are handed over one by one: putting them into a NamedTuple takes longer than what is done with them here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.types import Array

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

FARTHEST = 1e6
"""Distances beyond this, m, are no distances."""

NONE_LEFT, NONE_NEAR = -1, -2
"""Instead of a pair that must be measured."""

UNIT = 1e-3
"""Normals whose square is further from 1 are no directions."""


class Near(NamedTuple):
    """Pairs within the distance that was asked for, in a fixed order, k of them."""

    pair: Indices
    """Numbers of the pairs, for :meth:`ik_node.collision.distances.Clearance.names`, (k,)."""
    distance: Array
    """(k,), m; negative in penetration."""
    slope: Array
    """d(distance)/dq, (k, n), m per rad (m)."""
    drift: Array
    """What the obstacles' own motion does to the distances, (k,), m/s; negative towards the arm."""
    self_collision: Array
    """1 for pairs of links, 0 for obstacles, (k,)."""


@compiled
def note_motion(
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
    """Notes how an obstacle moves; how far any point of it is from where it was at most, m.

    ``new_pose``, ``old_pose`` (4, 4), ``velocity``, ``spin`` (3,) in the base frame, which the root sees at
    ``root_base`` (4, 4); ``reach``: largest distance of its points from its origin. ``speeds`` (obstacles,): no point
    is faster. ``motions`` (obstacles, 3, 3): velocities, angular velocities and origins, in the root's axes.
    """
    speeds[obstacle] = _size(velocity) + _size(spin) * reach
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
def _size(vector: Array) -> float:
    return float(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]))


@compiled
def lower_bounds_of(solid: int, motion: float, seconds: Indices, bound: Array) -> None:
    """Lowers the bounds of the pairs whose second is a solid that has moved by ``motion``, m."""
    for pair in range(len(bound)):
        if seconds[pair] == solid:
            bound[pair] -= motion


@compiled
def fastest_approach(
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
    """(pairs,): how fast a distance can shrink at most, m/s.

    ``motion`` (m,): velocities of the moving joints; ``change`` (n,): by how much the controlled joints' differ from
    that; ``jacobian`` (m, 6): twists that the moving joints give. ``centres`` (links, 3), ``radii`` (links,): balls
    around the links, m. ``obstacle_speeds`` (obstacles,): no point of theirs is faster, m/s.
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
        fastest[link] = np.sqrt(vx * vx + vy * vy + vz * vz) + _size(spin) * radii[link]
    speeds = np.empty(len(firsts))
    for pair in range(len(firsts)):
        changed = 0.0
        for joint in range(len(change)):
            changed += reach[pair, joint] * change[joint]
        speeds[pair] = fastest[firsts[pair]] + fastest[seconds[pair]] + changed
    return speeds


@compiled
def lower_bounds(motion: Array, reach: Array, bound: Array, fresh: Flags, within: Array, closest: bool) -> int:
    """Lowers the bounds by a motion of the controlled joints, (n,), after which nothing is fresh; the first pair to
    measure, see :func:`next_pair`."""
    for pair in range(len(bound)):
        moved = 0.0
        for joint in range(len(motion)):
            moved += reach[pair, joint] * abs(motion[joint])
        bound[pair] -= moved
        fresh[pair] = False
    return next_pair(bound, fresh, within, closest)


@compiled
def next_pair(bound: Array, fresh: Flags, within: Array, closest: bool) -> int:
    """A pair that must be measured, nearer than ``within`` (pairs,) as far as is known, then, if the ``closest`` is
    wanted, what still might be nearer than the nearest found so far. Where none is left: :data:`NONE_LEFT`, or
    :data:`NONE_NEAR` if none that was measured is nearer than ``within``."""
    left = NONE_NEAR
    for pair in range(len(bound)):
        # A NaN counts as near.
        if not bound[pair] >= within[pair]:
            if not fresh[pair]:
                return pair
            left = NONE_LEFT
    if closest:
        nearest = int(np.argmin(bound))
        if not fresh[nearest]:
            return nearest
    return left


@compiled
def take_measurement(
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
    """Notes what was measured of a pair; the next pair to measure, see :func:`next_pair`.

    ``normal``, ``first``, ``second`` (3,): direction and nearest points. ``origins`` (solids, 3): the solids' own.
    """
    square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]
    if abs(distance) < FARTHEST and abs(square - 1.0) < UNIT:
        bound[pair], normals[pair], points[pair, 0], points[pair, 1] = distance, normal, first, second
    else:
        # EPA can fail in deep penetration: in contact, direction by the centres.
        start, end = origins[firsts[pair]], origins[seconds[pair]]
        apart = end - start
        bound[pair], normals[pair] = 0.0, apart / np.maximum(_size(apart), 1e-9)
        points[pair, 0], points[pair, 1] = start, end
    fresh[pair] = True
    return next_pair(bound, fresh, within, closest)


@compiled
def list_near(
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
    """Writes the measured pairs nearer than ``within`` (pairs,) into the first rows of the arrays of a :class:`Near`,
    ``pairs`` to ``own``, that has room for all; how many there are.

    ``jacobian`` (m, 6): twists that the moving joints give. ``ratio`` (m, n): their motion per controlled joint.
    ``obstacle_motions`` (obstacles, 3, 3) as in :func:`note_motion`.
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
    """How fast a twist (v, w) moves a point p along n: n.v + (p x n).w ."""
    speed = normal[0] * twist[0] + normal[1] * twist[1] + normal[2] * twist[2]
    speed += (point[1] * normal[2] - point[2] * normal[1]) * twist[3]
    speed += (point[2] * normal[0] - point[0] * normal[2]) * twist[4]
    return float(speed + (point[0] * normal[1] - point[1] * normal[0]) * twist[5])


@compiled
def _drift(normal: Array, point: Array, motion: Array) -> float:
    """How fast an obstacle's own motion, (3, 3) as in :func:`note_motion`, carries a point of it along the normal."""
    velocity, spin, lever = motion[0], motion[1], point - motion[2]
    drift = normal[0] * (velocity[0] + (spin[1] * lever[2] - spin[2] * lever[1]))
    drift += normal[1] * (velocity[1] + (spin[2] * lever[0] - spin[0] * lever[2]))
    return float(drift + normal[2] * (velocity[2] + (spin[0] * lever[1] - spin[1] * lever[0])))


@compiled
def closest_pair(bound: Array, points: Array, pose: Array) -> tuple[int, float, Array]:
    """The closest pair, its distance, and its nearest points (2, 3), in a frame with the root at ``pose`` (4, 4)."""
    pair = int(np.argmin(bound))
    seen = np.empty((2, 3))
    for end in range(2):
        x, y, z = points[pair, end, 0], points[pair, end, 1], points[pair, end, 2]
        for axis in range(3):
            seen[end, axis] = x * pose[axis, 0] + y * pose[axis, 1] + z * pose[axis, 2] + pose[axis, 3]
    return pair, float(bound[pair]), seen

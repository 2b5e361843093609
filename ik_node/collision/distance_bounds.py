"""Compiled lower bounds of distances, and the pairs whose distances have to be computed.

Solids are indexed: first the links of the arm, then the obstacles. Pairs are indexed, too: first the P pairs of links,
then for each obstacle one pair with each of the links in ``links`` (those that a joint moves). All vectors are
expressed in the root frame of the model. ``moves`` (links, m) is 1 where a moving joint moves a link; ``reach``
(links, n) bounds the motion of the points of a link per joint motion, m per rad (1 for m).

Each solid lies within a capsule, a row of 7 numbers: one end of its axis, the vector to the other end, the radius, m.
The distance of two capsules is a lower bound of the distance of their solids, also in penetration.

Bounds are kept between control steps. ``travel`` (links + 1,) is the sum of the motions of each link, m, and in its
last element the sum of the largest motion of any link; ``obstacle_travel`` is that of the obstacles. ``key`` (pairs,)
is a lower bound of the distance when it was computed plus the travel of both solids then, so that ``key`` minus the
travel of both now is a lower bound of the distance now. ``level`` (obstacles,) is the same for the nearest of the
capsules of an obstacle, with the last element of ``travel``: an obstacle far away costs one comparison.

The arrays are separate arguments because packing them into a NamedTuple takes longer than these functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.bounding_capsule import capsule_distance, capsule_points
from ik_node.jit import compiled
from ik_node.math.types import Array

Indices = NDArray[np.int64]

MARGIN_M = 1e-5
"""Subtracted from bounds: more than the rounding errors of the bounds and the tolerances of computed distances."""

MOST_COMPUTED = 576
"""Pairs whose exact distance is computed in one query, in the order of their bounds; the distances of further ones are
those of their capsules, which are shorter. 64 obstacles and nine links are never more; a computation takes 1 us."""

BLOCK = 64
"""Obstacles that are compared at once."""


class Limits(NamedTuple):
    """Distances within which pairs matter, for the potential (its ranges) or for velocity dampers."""

    own_range: float
    """Of pairs of links, m."""
    obstacle_range: float
    """Of pairs of link and obstacle, m."""
    own_stop: float = 0.0
    """Stop distance of pairs of links, m."""
    stop: float = 0.0
    """Stop distance of pairs of link and obstacle, m."""
    damper_range: float = 0.0
    """Largest distance of a pair with a velocity damper, m; 0 for no dampers."""
    deceleration: float = 1.0
    """Deceleration that dampers assume, m/s2."""
    hold_s: float = 0.0
    """Longest time for which a command is held, s."""


@compiled
def find_near_pairs(
    step: Array,
    motion: Array,
    change: Array,
    jacobian: Array,
    moves: Array,
    reach: Array,
    places: Array,
    local: Array,
    capsules: Array,
    firsts: Indices,
    seconds: Indices,
    links: Indices,
    obstacle_capsules: Array,
    obstacle_speeds: Array,
    fastest_obstacle: float,
    travel: Array,
    obstacle_travel: Array,
    key: Array,
    level: Array,
    limits: Limits,
    likely: float,
    listed: Indices,
    within: Array,
    distances: Array,
    normals: Array,
    points: Array,
) -> tuple[int, int]:
    """Lists the pairs whose distance may be below the limit of the pair, or below ``likely``.

    If more than :data:`MOST_COMPUTED` pairs of capsules are nearer than their limits, the nearest of these are listed,
    and behind them the others with the distances of their capsules. Which these are depends on the present placements
    only.

    Args:
        step: Motion of the controlled joints since the last call, (n,), rad (m).
        motion: Velocities of the moving joints, (m,), rad/s (m/s).
        change: Largest difference of the velocities of the controlled joints from those, (n,), rad/s (m/s).
        jacobian: Twists per joint velocity, (m, 6), linear part first.
        moves: 1 where a joint moves a link, (links, m).
        reach: Bound of the motion of a link per joint motion, (links, n), m per rad (1 for m).
        places: Rotations of the links by columns, and origins, (links, 12).
        local: Bounding capsules in the frames of the links, (links, 7).
        capsules: Written: bounding capsules, (links, 7).
        firsts: First link of each pair of links, (P,).
        seconds: Second link of each pair of links, (P,).
        links: Links that are paired with obstacles.
        obstacle_capsules: Bounding capsules of the obstacles, (obstacles, 7).
        obstacle_speeds: Upper bounds of the speeds of the obstacles, (obstacles,), m/s.
        fastest_obstacle: The largest of them, m/s.
        travel: Increased by the motion of the links, (links + 1,), m.
        obstacle_travel: Travel of the obstacles, (obstacles,), m.
        key: Updated: bounds, (pairs,), m.
        level: Updated: bounds of the obstacles, (obstacles,), m.
        limits: The limits.
        likely: The last distance of the closest pair, m: pairs that may be below it are computed in any case, so it is
            faster to list them at once; -inf when the closest pair is not wanted.
        listed: Written: indices of pair, first and second solid, (pairs, 3).
        within: Written: limits of the listed pairs, (pairs,), m.
        distances: Written for pairs that are not to be computed: distances of the capsules, (pairs,), m.
        normals: Likewise, unit vectors from the first to the second capsule, (pairs, 3).
        points: Likewise, nearest points of the capsules, (pairs, 2, 3), m.

    Returns:
        Number of pairs to be computed, and number of listed pairs.
    """
    count, own = len(reach), len(firsts)
    speeds = np.zeros(count)
    fastest = _advance(step, motion, change, jacobian, moves, reach, places, local, capsules, limits, travel, speeds)
    if not travel[count] < np.inf:  # a position that is not finite says nothing about the distances
        travel[:], obstacle_travel[:], key[:], level[:] = 0.0, 0.0, -np.inf, -np.inf
    number = 0
    for pair in range(own):
        first, second = firsts[pair], seconds[pair]
        limit = _limit(limits.own_range, limits.own_stop, speeds[first] + speeds[second], limits)
        nearer = np.maximum(limit, likely)
        bound = key[pair] - travel[first] - travel[second]
        if not bound >= nearer:
            bound = refined_bound(pair, bound, capsules, first, capsules, second, travel[first] + travel[second], key)
        if not bound >= nearer:
            listed[number, 0], listed[number, 1], listed[number, 2] = pair, first, second
            within[number] = limit
            number += 1
    own_number, near = number, 0
    longest = np.maximum(_limit(limits.obstacle_range, limits.stop, fastest + fastest_obstacle, limits), likely)
    for begin in range(0, len(level), BLOCK):
        end = min(begin + BLOCK, len(level))
        if not any_below(begin, end, longest + travel[count], level, obstacle_travel):
            continue
        for obstacle in range(begin, end):
            gone, lowest = obstacle_travel[obstacle], np.inf
            if level[obstacle] - travel[count] - gone >= longest:
                continue
            for place in range(len(links)):
                link, pair = links[place], own + obstacle * len(links) + place
                speed = speeds[link] + obstacle_speeds[obstacle]
                limit = _limit(limits.obstacle_range, limits.stop, speed, limits)
                apart = capsule_distance(capsules, link, obstacle_capsules, obstacle) - MARGIN_M
                lowest = np.minimum(lowest, apart)
                near += not apart >= limit
                bound = key[pair] - travel[link] - gone
                if apart > bound:
                    key[pair], bound = apart + travel[link] + gone, apart
                if not bound >= np.maximum(limit, likely):
                    listed[number, 0], listed[number, 1], listed[number, 2] = pair, link, count + obstacle
                    within[number] = limit
                    number += 1
            level[obstacle] = lowest + travel[count] + gone
    if near > MOST_COMPUTED:
        return _list_crowd(
            own_number,
            near,
            longest,
            own,
            links,
            capsules,
            speeds,
            obstacle_capsules,
            obstacle_speeds,
            travel,
            obstacle_travel,
            key,
            level,
            limits,
            listed,
            within,
            distances,
            normals,
            points,
        )
    return number, number


@compiled
def _list_crowd(
    number: int,
    near: int,
    longest: float,
    own: int,
    links: Indices,
    capsules: Array,
    speeds: Array,
    obstacle_capsules: Array,
    obstacle_speeds: Array,
    travel: Array,
    obstacle_travel: Array,
    key: Array,
    level: Array,
    limits: Limits,
    listed: Indices,
    within: Array,
    distances: Array,
    normals: Array,
    points: Array,
) -> tuple[int, int]:
    """Lists the ``near`` pairs of obstacles whose capsules are nearer than their limits, behind ``number`` pairs of
    links; see :func:`find_near_pairs`, also for the result. Obstacles whose bound is above ``longest`` have none."""
    count, found = len(capsules), 0
    apart, limit, who = np.empty(near), np.empty(near), np.empty((near, 3), np.int64)
    for obstacle in range(len(level)):
        if level[obstacle] - travel[count] - obstacle_travel[obstacle] >= longest:
            continue
        for place in range(len(links)):
            link = links[place]
            speed = speeds[link] + obstacle_speeds[obstacle]
            limit[found] = _limit(limits.obstacle_range, limits.stop, speed, limits)
            apart[found] = capsule_distance(capsules, link, obstacle_capsules, obstacle) - MARGIN_M
            if not apart[found] >= limit[found]:
                who[found, 0], who[found, 1] = own + obstacle * len(links) + place, link
                who[found, 2] = count + obstacle
                found += 1
                if found == near:
                    break
        if found == near:
            break
    farthest = np.partition(apart, MOST_COMPUTED)[MOST_COMPUTED]
    for row in range(near):
        bound = key[who[row, 0]] - travel[who[row, 1]] - obstacle_travel[who[row, 2] - count]
        if apart[row] < farthest and not bound >= limit[row]:
            listed[number], within[number] = who[row], limit[row]
            number += 1
    computed = number
    for row in range(near):
        if not apart[row] < farthest:
            listed[number], within[number] = who[row], limit[row]
            link, obstacle = who[row, 1], who[row, 2] - count
            distances[number] = capsule_points(
                capsules, link, obstacle_capsules, obstacle, normals[number], points[number]
            )
            number += 1
    return computed, number


@compiled
def _advance(
    step: Array,
    motion: Array,
    change: Array,
    jacobian: Array,
    moves: Array,
    reach: Array,
    places: Array,
    local: Array,
    capsules: Array,
    limits: Limits,
    travel: Array,
    speeds: Array,
) -> float:
    """Places the capsules of the links and adds their travel. With dampers, writes upper bounds of the speeds of the
    links (links,), m/s; returns the largest. The other arguments are those of :func:`find_near_pairs`."""
    farthest = fastest = 0.0
    for link in range(len(reach)):
        moved = 0.0
        for joint in range(len(step)):
            moved += reach[link, joint] * abs(step[joint])
        travel[link] += moved
        farthest = np.maximum(farthest, moved)  # NaN remains
        for axis in range(3):
            start = along = 0.0
            for column in range(3):
                start += places[link, 3 * column + axis] * local[link, column]
                along += places[link, 3 * column + axis] * local[link, 3 + column]
            capsules[link, axis], capsules[link, 3 + axis] = start + places[link, 9 + axis], along
        capsules[link, 6] = local[link, 6]
        if limits.damper_range > 0.0:
            speeds[link] = _largest_speed(link, motion, change, jacobian, moves, reach, capsules)
            fastest = np.maximum(fastest, speeds[link])
    travel[len(reach)] += farthest
    return float(fastest)


@compiled
def any_below(begin: int, end: int, limit: float, level: Array, obstacle_travel: Array) -> bool:
    """True when the bound of one of the obstacles is below ``limit`` or NaN; without branches in its loop, which LLVM
    compiles to vector instructions."""
    count = 0
    for obstacle in range(begin, end):
        count += not level[obstacle] - obstacle_travel[obstacle] >= limit
    return count > 0


@compiled
def _limit(repelled: float, stop: float, speed: float, limits: Limits) -> float:
    # At a larger distance the pair cannot approach so fast that it could no longer stop.
    needed = speed * (0.5 * speed / limits.deceleration + 1.5 * limits.hold_s) + stop
    return float(np.maximum(repelled, np.minimum(needed, limits.damper_range)))


@compiled
def _largest_speed(
    link: int, motion: Array, change: Array, jacobian: Array, moves: Array, reach: Array, capsules: Array
) -> float:
    """Upper bound of the speeds of the points of a link, m/s."""
    vx = vy = vz = wx = wy = wz = 0.0
    for joint in range(len(motion)):
        if moves[link, joint] != 0.0:
            rate = motion[joint]
            vx += rate * jacobian[joint, 0]
            vy += rate * jacobian[joint, 1]
            vz += rate * jacobian[joint, 2]
            wx += rate * jacobian[joint, 3]
            wy += rate * jacobian[joint, 4]
            wz += rate * jacobian[joint, 5]
    largest = 0.0
    for end in range(2):
        x = capsules[link, 0] + end * capsules[link, 3]
        y = capsules[link, 1] + end * capsules[link, 4]
        z = capsules[link, 2] + end * capsules[link, 5]
        sx, sy, sz = vx + (wy * z - wz * y), vy + (wz * x - wx * z), vz + (wx * y - wy * x)
        largest = np.maximum(largest, np.sqrt(sx * sx + sy * sy + sz * sz))
    largest += np.sqrt(wx * wx + wy * wy + wz * wz) * capsules[link, 6]
    for joint in range(len(change)):
        largest += reach[link, joint] * change[joint]
    return float(largest)


@compiled
def refined_bound(
    pair: int,
    bound: float,
    capsules: Array,
    first: int,
    other_capsules: Array,
    second: int,
    travel: float,
    key: Array,
) -> float:
    """The bound of a pair, increased to that of its capsules."""
    found = capsule_distance(capsules, first, other_capsules, second) - MARGIN_M
    if found > bound:
        key[pair] = found + travel
        return found
    return bound

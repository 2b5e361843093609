"""Compiled search for the closest pair by lower bounds; arrays are those of :mod:`.distance_bounds`."""

from __future__ import annotations

import numpy as np

from ik_node.collision.bounding_capsule import capsule_distance
from ik_node.collision.distance_bounds import BLOCK, MARGIN_M, Indices, any_below, refined_bound
from ik_node.jit import compiled
from ik_node.math.types import Array


@compiled
def next_closest(
    row: int,
    closest: float,
    tick: int,
    capsules: Array,
    firsts: Indices,
    seconds: Indices,
    links: Indices,
    obstacle_capsules: Array,
    travel: Array,
    obstacle_travel: Array,
    key: Array,
    level: Array,
    computed: Indices,
    closed: Indices,
    listed: Indices,
) -> int:
    """Writes a pair that may be nearer than ``closest``, m, into a row of ``listed``; returns ``row`` + 1, or ``row``
    when there is no such pair."""
    count, own = len(capsules), len(firsts)
    while True:
        pair, lowest = _nearest_own(closest, tick, capsules, firsts, seconds, travel, key, computed)
        obstacle = _nearest_obstacle(lowest, tick, travel[count], obstacle_travel, level, closed)
        if obstacle < 0:
            if pair < 0:
                return row
            listed[row, 0], listed[row, 1], listed[row, 2] = pair, firsts[pair], seconds[pair]
            return row + 1
        chosen, gone, lowest, nearest = -1, obstacle_travel[obstacle], np.inf, closest
        for place in range(len(links)):
            link, pair = links[place], own + obstacle * len(links) + place
            apart = capsule_distance(capsules, link, obstacle_capsules, obstacle) - MARGIN_M
            lowest = np.minimum(lowest, apart)
            bound = np.maximum(key[pair] - travel[link] - gone - MARGIN_M, apart)
            if computed[pair] != tick and not bound >= nearest:
                nearest, chosen = bound, place
        level[obstacle] = lowest + travel[count] + gone
        if chosen >= 0:
            listed[row, 0] = own + obstacle * len(links) + chosen
            listed[row, 1], listed[row, 2] = links[chosen], count + obstacle
            return row + 1
        closed[obstacle] = tick


@compiled
def _nearest_own(
    closest: float,
    tick: int,
    capsules: Array,
    firsts: Indices,
    seconds: Indices,
    travel: Array,
    key: Array,
    computed: Indices,
) -> tuple[int, float]:
    """Pair of links with the lowest bound below ``closest`` that is not computed yet, or -1; and that bound, m."""
    lowest, chosen = closest, -1
    for pair in range(len(firsts)):
        if computed[pair] == tick:
            continue
        first, second = firsts[pair], seconds[pair]
        away = travel[first] + travel[second]
        bound = key[pair] - away - MARGIN_M
        if not bound >= lowest:
            bound = refined_bound(pair, bound, capsules, first, capsules, second, away, key)
        if not bound >= lowest:
            lowest, chosen = bound, pair
    return chosen, lowest


@compiled
def _nearest_obstacle(
    lowest: float, tick: int, travel: float, obstacle_travel: Array, level: Array, closed: Indices
) -> int:
    """Obstacle with the lowest bound below ``lowest`` that is not closed, or -1."""
    nearest = -1
    for begin in range(0, len(level), BLOCK):
        end = min(begin + BLOCK, len(level))
        if not any_below(begin, end, lowest + travel + MARGIN_M, level, obstacle_travel):
            continue
        for obstacle in range(begin, end):
            bound = level[obstacle] - travel - obstacle_travel[obstacle] - MARGIN_M
            if closed[obstacle] != tick and not bound >= lowest:
                lowest, nearest = bound, obstacle
    return nearest

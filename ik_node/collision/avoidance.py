"""Staying clear: a potential that pushes the null space away, and dampers that keep the speed of approach low.

::

    h   = F sum psi(d)         psi = 0                      beyond the range r
                               psi = r / 4 (1 - d / r)^4    from there to contact
                               psi = r / 4 - d              in penetration

psi is three times continuously differentiable at the range and its slope, -(1 - d / r)^3, stays at -1 in penetration:
the push never exceeds F per pair and never changes its sign. The cube lets the nearest pair have its way where several
pull apart. F is a force (N), h an energy (J).

What counts is h(q) + h(q + tau qd): where the arm is, and where it will be after ``look_ahead_s`` if it goes on as it
does. Without the second an elbow dodges to the side that is free now and meets the obstacle on its way back.

A damper limits what a pair may lose of its distance to the speed from which it can still stop::

    d(distance)/dq qd + drift >= -b(d) ,     b(d) = vbar(d - stop) at the deceleration ``approach_deceleration``

with vbar of :func:`ik_node.robot.joint_limits.viable_speed`, so that it is safe for held commands, and drift the obstacle's own
motion. It only ever limits approach: gaining distance is free at every d. Inside the stop distance it allows no
approach; it asks for retreat only from an obstacle that comes nearer by itself.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ik_node.collision.distance_kernels import Indices, fastest_approach
from ik_node.collision.distances import Clearance, Closest, Near
from ik_node.collision.scene import Scene
from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.joint_limits import viable_speed_at
from ik_node.settings.groups import ObstacleSettings


class Potential(NamedTuple):
    """A potential at one q."""

    value: float
    """h, J."""
    gradient: Array
    """grad_h, (n,), N m per rad (N per m)."""


class Surroundings(NamedTuple):
    """What a tick needs to know of obstacles and of the arm itself."""

    potential: Potential
    dampers: VelocityDampers
    closest: Closest


@compiled
def push(distance: Array, span: Array) -> tuple[Array, Array]:
    """psi and its slope at ``distance`` (k,) for ranges ``span`` (k,), m."""
    value, slope = np.empty(len(distance)), np.empty(len(distance))
    for row in range(len(distance)):
        value[row], slope[row] = _push(distance[row], span[row])
    return value, slope


@compiled
def _push(distance: float, span: float) -> tuple[float, float]:
    # np.minimum and np.maximum hand a NaN on.
    part = np.minimum(np.maximum(1.0 - distance / span, 0.0), 1.0)
    slope = -part * part * part
    return np.maximum(-distance, 0.0) - 0.25 * span * part * slope, slope


def repulsion(near: Near, count: int, settings: ObstacleSettings) -> Potential:
    """h and grad_h of the pairs in the first ``count`` rows of ``near``."""
    if count == 0:
        return _no_push(near.slope.shape[1])
    value, gradient = _repulsion(
        count, near.distance, near.slope, near.self_collision, settings.self_range, settings.range, settings.strength
    )
    return Potential(value, gradient)


@compiled
def _repulsion(
    count: int, distance: Array, slope: Array, own: Array, self_range: float, obstacle_range: float, strength: float
) -> tuple[float, Array]:
    total, gradient = 0.0, np.zeros(slope.shape[1])
    for row in range(count):
        value, steepness = _push(distance[row], self_range if own[row] > 0.0 else obstacle_range)
        total += value
        for joint in range(len(gradient)):
            gradient[joint] += steepness * slope[row, joint]
    return strength * total, strength * gradient


def dampers(
    clearance: Clearance, count: int, qd: Array, change: Array, settings: ObstacleSettings, hold_s: float
) -> VelocityDampers:
    """The dampers of the first ``count`` rows of ``clearance`` that can bind at velocities within ``change`` (n,) of
    ``qd`` (n,), rad/s (m/s)."""
    if count == 0:
        return _no_dampers(len(qd))
    near = clearance.rows
    can_bind, rows, least = _dampers(
        count,
        near.distance,
        near.slope,
        near.drift,
        near.self_collision,
        qd,
        change,
        settings.self_stop_distance,
        settings.stop_distance,
        settings.approach_deceleration,
        hold_s,
    )
    names = tuple(" - ".join(clearance.names(near.pair[row])) for row in can_bind.tolist())
    return VelocityDampers(rows, least, names)


@compiled
def _dampers(
    count: int,
    distance: Array,
    slope: Array,
    drift: Array,
    own: Array,
    qd: Array,
    change: Array,
    self_stop: float,
    stop: float,
    deceleration: float,
    hold_s: float,
) -> tuple[Indices, Array, Array]:
    """Which of them can bind, the rows of ``slope`` (k, n) of these, and what they are to be at least."""
    least, can_bind = np.empty(count), np.zeros(count, np.bool_)
    for row in range(count):
        room = distance[row] - (self_stop if own[row] > 0.0 else stop)
        least[row] = -viable_speed_at(room, deceleration, hold_s, hold_s) - drift[row]
        slowest = 0.0
        for joint in range(len(qd)):
            slowest += slope[row, joint] * qd[joint] - abs(slope[row, joint]) * change[joint]
        can_bind[row] = not slowest >= least[row]
    which = np.flatnonzero(can_bind)
    return which, slope[which], least[which]


@compiled
def _within(
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
    own: Array,
    self_range: float,
    obstacle_range: float,
    self_stop: float,
    stop: float,
    damper_range: float,
    deceleration: float,
    hold_s: float,
) -> Array:
    """(pairs,): the distances within which pairs count for the potential (ranges, 0 without) or for the dampers, m.

    ``motion`` to ``reach``: of :func:`ik_node.collision.distance_kernels.fastest_approach`.
    """
    speeds = fastest_approach(motion, change, jacobian, moves, centres, radii, obstacle_speeds, firsts, seconds, reach)
    within = np.empty(len(speeds))
    for pair in range(len(speeds)):
        speed, is_own = speeds[pair], own[pair] > 0.0
        # Beyond this distance a pair cannot come near so fast that it could not stop.
        needed = speed * (0.5 * speed / deceleration + 1.5 * hold_s) + (self_stop if is_own else stop)
        pushed = self_range if is_own else obstacle_range
        within[pair] = np.maximum(pushed, np.minimum(needed, damper_range))
    return within


def look_around(
    clearance: Clearance,
    scene: Scene,
    q: Array,
    qd: Array,
    change: Array,
    settings: ObstacleSettings,
    hold_s: float,
    time_ns: int,
    repel: bool = True,
) -> Surroundings:
    """Potential, dampers and clearance at q (n,).

    ``qd`` (n,): the velocity that stands now; ``change`` (n,): by how much the next one can differ from it. ``hold_s``:
    the longest hold. ``repel``: False where the method has no use for the potential.
    """
    clearance.see(scene, time_ns)
    ranges = (settings.self_range, settings.range) if repel else (0.0, 0.0)
    if settings.damper and clearance.pairs:
        within = _within(
            *clearance.motions(q, qd, change),
            clearance.self_pairs(),
            *ranges,
            settings.self_stop_distance,
            settings.stop_distance,
            settings.damper_range,
            settings.approach_deceleration,
            hold_s,
        )
    else:
        within = _ranges(clearance.self_pairs(), *ranges)
    count = clearance.survey(q, within)
    brakes = dampers(clearance, count, qd, change, settings, hold_s) if settings.damper else _no_dampers(len(q))
    potential = repulsion(clearance.rows, count, settings) if repel else _no_push(len(q))
    if repel and settings.look_ahead_s > 0.0 and any(qd.tolist()):
        ahead = clearance.ahead
        ahead.see(scene, time_ns + round(settings.look_ahead_s * NS))
        pushing = _ranges(clearance.self_pairs(), *ranges)
        count_ahead = ahead.survey(q + settings.look_ahead_s * qd, pushing, closest=False)
        later = repulsion(ahead.rows, count_ahead, settings)
        potential = Potential(potential.value + later.value, potential.gradient + later.gradient)
    return Surroundings(potential, brakes, clearance.closest())


@compiled
def _ranges(own: Array, self_range: float, obstacle_range: float) -> Array:
    """(pairs,): the ranges of the potential, m."""
    return np.where(own > 0.0, self_range, obstacle_range)


@cache
def _no_push(n: int) -> Potential:
    return Potential(0.0, np.zeros(n))


@cache
def _no_dampers(n: int) -> VelocityDampers:
    return VelocityDampers(np.zeros((0, n)), np.zeros(0), ())

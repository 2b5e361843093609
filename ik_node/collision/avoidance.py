"""Collision avoidance: a repulsive potential for the null space, and velocity dampers that bound the approach speed.

The potential is ::

    h   = F sum psi(d)         psi = 0                      for d >= r (the range)
                               psi = r / 4 (1 - d / r)^4    for 0 <= d < r
                               psi = r / 4 - d              for d < 0 (penetration)

psi is three times continuously differentiable at d = r. Its slope -(1 - d / r)^3 stays at -1 in penetration, so the
repulsion of a pair never exceeds F and never changes sign. Because of the cube the nearest pair dominates where several
pairs push in opposite directions. F is a force (N), h an energy (J).

The sum h(q) + h(q + tau qd) is used: at the present position, and at the position predicted for tau = ``LOOK_AHEAD_S``
at constant velocity. Without the second term an elbow evades to the side that is free now and meets the obstacle on its
way back.

A velocity damper bounds the rate at which a pair loses distance by the speed from which the arm can still stop::

    d(distance)/dq qd + drift >= -b(d) ,     b(d) = vbar(d - stop) at the deceleration ``approach_deceleration``

with vbar of :func:`ik_node.robot.joint_limits.viable_speed_at`, which is valid for commands that are held constant over
a control step, and drift the rate due to the obstacle's own motion. Dampers bound the approach only; a growing distance
is never constrained. Inside the stop distance no approach is permitted; retreat is required only from an obstacle that
itself approaches.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ik_node.collision.distance_bounds import Indices, Limits
from ik_node.collision.distance_kernels import NearPairs
from ik_node.collision.distances import ClosestPair, DistanceQuery
from ik_node.collision.scene import Scene
from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.joint_limits import viable_speed_at
from ik_node.settings.groups import ObstacleSettings

LOOK_AHEAD_S = 0.5
"""tau: the potential is also evaluated at the position predicted for this time ahead."""
DAMPER_RANGE_M = 0.5
"""Pairs at a larger distance get no velocity damper."""


class Potential(NamedTuple):
    """Value and gradient of a potential at one position."""

    value: float
    """h, J."""
    gradient: Array
    """grad_h, (n,), N m per rad (N per m)."""


class AvoidanceTerms(NamedTuple):
    """Terms of the differential inverse kinematics at one position, and the closest pair."""

    potential: Potential
    """Repulsive potential h."""
    dampers: VelocityDampers
    """Bounds of the approach speeds."""
    closest: ClosestPair


@compiled
def repulsion_profile(distance: Array, span: Array) -> tuple[Array, Array]:
    """psi (k,), m, and its slope (k,) at ``distance`` (k,), m, for ranges ``span`` (k,), m."""
    value, slope = np.empty(len(distance)), np.empty(len(distance))
    for row in range(len(distance)):
        value[row], slope[row] = _profile(distance[row], span[row])
    return value, slope


@compiled
def _profile(distance: float, span: float) -> tuple[float, float]:
    # np.minimum and np.maximum propagate NaN.
    depth = np.minimum(np.maximum(1.0 - distance / span, 0.0), 1.0)
    slope = -depth * depth * depth
    return np.maximum(-distance, 0.0) - 0.25 * span * depth * slope, slope


def repulsion(near: NearPairs, count: int, settings: ObstacleSettings) -> Potential:
    """Repulsive potential of the pairs in the first ``count`` rows of ``near``."""
    if count == 0:
        return _no_potential(near.slope.shape[1])
    value, gradient = _repulsion(
        count,
        near.distance,
        near.slope,
        near.self_collision,
        settings.repulsion_range[1],
        settings.repulsion_range[0],
        settings.repulsion_force,
    )
    return Potential(value, gradient)


@compiled
def _repulsion(
    count: int, distance: Array, slope: Array, own: Array, self_range: float, obstacle_range: float, strength: float
) -> tuple[float, Array]:
    total, gradient = 0.0, np.zeros(slope.shape[1])
    for row in range(count):
        value, steepness = _profile(distance[row], self_range if own[row] > 0.0 else obstacle_range)
        total += value
        for joint in range(len(gradient)):
            gradient[joint] += steepness * slope[row, joint]
    return strength * total, strength * gradient


def velocity_dampers(
    distances: DistanceQuery, count: int, qd: Array, change: Array, settings: ObstacleSettings, hold_s: float
) -> VelocityDampers:
    """Dampers of the first ``count`` rows of ``distances.rows`` that can bind at velocities within ``change`` (n,) of
    ``qd`` (n,), rad/s (m/s)."""
    if count == 0:
        return _no_dampers(len(qd))
    near = distances.rows
    can_bind, rows, least = _dampers(
        count,
        near.distance,
        near.slope,
        near.drift,
        near.self_collision,
        qd,
        change,
        settings.stop_distance[1],
        settings.stop_distance[0],
        settings.approach_deceleration,
        hold_s,
    )
    names = tuple(" - ".join(distances.names(pair)) for pair in near.pair[can_bind].tolist())
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
    """Indices of the dampers that can bind, their rows of ``slope`` (k, n), and their lower bounds (k,), m/s."""
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


def avoidance_terms(
    distances: DistanceQuery,
    scene: Scene,
    q: Array,
    qd: Array,
    change: Array,
    settings: ObstacleSettings,
    hold_s: float,
    time_ns: int,
    repel: bool = True,
) -> AvoidanceTerms:
    """Computes the repulsive potential, the velocity dampers and the closest pair.

    Args:
        distances: Distance computation of the arm.
        scene: The obstacles.
        q: Joint positions, (n,), rad (m).
        qd: Present joint velocities, (n,), rad/s (m/s).
        change: Largest difference of the next velocities from ``qd``, (n,), rad/s (m/s).
        settings: Ranges, stop distances and gains.
        hold_s: Longest time for which a command is held, s.
        time_ns: Monotonic time, ns; moving obstacles are extrapolated to it.
        repel: False for no potential.

    Returns:
        The terms; gradients of shape (n,), k dampers.
    """
    distances.set_scene(scene, time_ns)
    ranges = (settings.repulsion_range[1], settings.repulsion_range[0]) if repel else (0.0, 0.0)
    limits = Limits(*ranges)
    if settings.velocity_damper:
        stop, own_stop = settings.stop_distance
        limits = Limits(*ranges, own_stop, stop, DAMPER_RANGE_M, settings.approach_deceleration, hold_s)
    count = distances.query(q, limits, qd, change)
    dampers = (
        velocity_dampers(distances, count, qd, change, settings, hold_s)
        if settings.velocity_damper
        else _no_dampers(len(q))
    )
    potential = repulsion(distances.rows, count, settings) if repel else _no_potential(len(q))
    if repel and any(qd.tolist()):
        predicted = distances.predicted
        predicted.set_scene(scene, time_ns + round(LOOK_AHEAD_S * NS), distances.arrays)
        count = predicted.query(q + LOOK_AHEAD_S * qd, Limits(*ranges), qd, change, closest=False)
        later = repulsion(predicted.rows, count, settings)
        potential = Potential(potential.value + later.value, potential.gradient + later.gradient)
    return AvoidanceTerms(potential, dampers, distances.closest())


@cache
def _no_potential(n: int) -> Potential:
    return Potential(0.0, np.zeros(n))


@cache
def _no_dampers(n: int) -> VelocityDampers:
    return VelocityDampers(np.zeros((0, n)), np.zeros(0), ())

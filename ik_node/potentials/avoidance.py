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

with vbar of :func:`ik_node.limits.viable_speed`, so that it is safe for held commands, and drift the obstacle's own
motion. It only ever limits approach: gaining distance is free at every d. Inside the stop distance it allows no
approach; it asks for retreat only from an obstacle that comes nearer by itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.bounded import Dampers
from ik_node.clearance import Clearance, Closest, Near
from ik_node.clock import NS
from ik_node.limits import viable_speed
from ik_node.scene import Scene
from ik_node.se3 import Array
from ik_node.settings import ObstacleSettings


class Potential(NamedTuple):
    """A potential at one q."""

    value: float
    """h, J."""
    gradient: Array
    """grad_h, (n,), N m per rad (N per m)."""


class Surroundings(NamedTuple):
    """What a tick needs to know of obstacles and of the arm itself."""

    potential: Potential
    dampers: Dampers
    closest: Closest


def push(distance: Array, span: Array) -> tuple[Array, Array]:
    """psi and its slope at ``distance`` (k,) for ranges ``span`` (k,), m."""
    part = np.minimum(np.maximum(1.0 - distance / span, 0.0), 1.0)
    beyond = np.maximum(-distance, 0.0)
    slope = -part * part * part
    return np.asarray(beyond - 0.25 * span * part * slope), slope


def repulsion(near: Near, settings: ObstacleSettings) -> Potential:
    """h and grad_h of the pairs in ``near``."""
    span = np.where(near.self_collision > 0.0, settings.self_range, settings.range)
    value, slope = push(near.distance, span)
    return Potential(settings.strength * float(value.sum()), settings.strength * (slope @ near.slope))


def dampers(
    clearance: Clearance, near: Near, qd: Array, change: Array, settings: ObstacleSettings, hold_s: float
) -> Dampers:
    """The dampers of ``near`` that can bind at velocities within ``change`` (n,) of ``qd`` (n,), rad/s (m/s)."""
    stop = np.where(near.self_collision > 0.0, settings.self_stop_distance, settings.stop_distance)
    allowed = viable_speed(near.distance - stop, settings.approach_deceleration, hold_s)
    least = -allowed - near.drift
    can_bind = np.flatnonzero(near.slope @ qd - np.abs(near.slope) @ change < least)
    names = tuple(" - ".join(clearance.names(near.pair[row])) for row in can_bind.tolist())
    return Dampers(near.slope[can_bind], least[can_bind], names)


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
    own = clearance.self_pairs() > 0.0
    within = np.where(own, settings.self_range, settings.range) if repel else np.zeros(clearance.pairs)
    pushing = within
    if settings.damper and clearance.pairs:
        # Beyond this distance a pair cannot come near so fast that it could not stop.
        speed = clearance.speeds(q, qd, change)
        needed = speed * (0.5 * speed / settings.approach_deceleration + 1.5 * hold_s)
        needed += np.where(own, settings.self_stop_distance, settings.stop_distance)
        within = np.maximum(within, np.minimum(needed, settings.damper_range))
    near, closest = clearance.measure(q, within)
    brakes = dampers(clearance, near, qd, change, settings, hold_s) if settings.damper else _none(len(q))
    potential = repulsion(near, settings) if repel else Potential(0.0, np.zeros(len(q)))
    if repel and settings.look_ahead_s > 0.0 and qd.any():
        ahead = clearance.ahead
        ahead.see(scene, time_ns + round(settings.look_ahead_s * NS))
        later = repulsion(ahead.near(q + settings.look_ahead_s * qd, pushing), settings)
        potential = Potential(potential.value + later.value, potential.gradient + later.gradient)
    return Surroundings(potential, brakes, closest)


def _none(n: int) -> Dampers:
    return Dampers(np.zeros((0, n)), np.zeros(0), ())

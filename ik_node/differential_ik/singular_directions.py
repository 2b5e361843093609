"""Analysis of the singular directions of a Jacobian: singular values, their derivatives, and feasible joint rates.

:mod:`ik_node.differential_ik.singularity` decides with these figures. Derivatives are central differences of the
Jacobian and of its decomposition: two evaluations of the kinematics for each direction, and only near singularities.

Singular values descend, so the critical directions, those below the threshold, are the last ones: ``first`` is the
index of the first of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.viable_scale import GROWTH, TURNING
from ik_node.jit import compiled
from ik_node.math.numerics import smoothstep
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, viable_speed_at

SPEED_FRACTION = 0.9
"""Fraction of the joint speeds that a singular direction may use; the rest of the twist needs some as well."""

ACCELERATION_FRACTION = 0.7
"""Fraction of the joint accelerations that are available for turning and for slowing down."""

NEAR_BOUNDARY_RAD = 0.15
"""Distance from a boundary, rad (m for a prismatic joint), up to which a direction is truncated ..."""

FAR_FROM_BOUNDARY_RAD = 0.35
"""... and from which it is retained."""

STEP = 1e-6
"""Step of finite differences, rad (m)."""

MIN_MOTION = 1e-12
"""A shorter joint motion has no direction."""

JacobianAt = Callable[[Array], Array]
"""q (n,) -> J (6, n), rows not scaled."""


class SingularDirections(NamedTuple):
    """The singular value decomposition D J = U S Y', and the twist along its directions."""

    row_scale: Array
    """D, (m,)."""
    u: Array
    """(m, m)."""
    sigma: Array
    """(m,)."""
    rows: Array
    """Y', right singular vectors as rows, (m, n)."""
    along: Array
    """U' D V, (m,)."""
    tolerance: float


class DirectionFigures(NamedTuple):
    """Figures of the k critical directions, (k,) each."""

    min_sigma: Array
    """sigma*: smallest sigma on the way if the arm continues straight on, m."""
    boundary_distance: Array
    """Distance from a workspace boundary, scaled: 0 at the boundary, 1 far from it or where there is none."""
    leaves_boundary: NDArray[np.bool_]
    """True if motion along the direction makes sigma grow."""
    max_rate: Array
    """Highest rate along the direction, rad/s (m/s)."""
    turn_scale: float
    """The factor <= 1 on V at which the joint accelerations of following V exactly are within their limits."""


def jacobians_beside(jacobian_at: JacobianAt, q: Array, directions: Array) -> Array:
    """J on both sides of q (n,), ``STEP`` away along each of the unit vectors ``directions`` (k, n): (k, 2, m, n)."""
    return np.array([(jacobian_at(q + STEP * unit), jacobian_at(q - STEP * unit)) for unit in directions])


@compiled
def bounded_rates(sigma: Array, along: Array, tolerance: float) -> Array:
    """alpha: along / sigma, bounded by along / (tolerance / 2) at sigma = 0, with a continuous slope."""
    x = sigma / tolerance
    return along / np.where(x < 1.0, 0.5 * tolerance * (1.0 + x * x), sigma)


@compiled
def needs_no_regulation(near: SingularDirections, rates: Array, limits: MotionLimits) -> bool:
    """True if the exact rates are feasible by bounds alone, without derivatives: rates are low, sigma is not.

    With C the longest column of D J, \\|dJ/dq qd qd\\| <= ``TURNING`` C \\|qd\\|^2 and
    \\|d sigma/d alpha\\| <= ``GROWTH`` C, with a margin on every arm that was tried.
    """
    smallest, margin = near.sigma[-1], near.sigma[-1] - near.tolerance
    if margin < near.tolerance:
        return False
    speed = np.sqrt((rates * rates).sum())
    if speed > SPEED_FRACTION * limits.velocity.min():
        return False
    acceleration, longest = ACCELERATION_FRACTION * limits.acceleration.min(), 0.0
    for joint in range(near.rows.shape[1]):
        longest = max(longest, ((near.sigma * near.rows[:, joint]) ** 2).sum())
    column = np.sqrt(longest)
    if TURNING * column * speed * speed > acceleration * smallest:
        return False
    return bool(speed <= viable_speed_at(margin / (GROWTH * column), acceleration, limits.dt_max_s, limits.dt_max_s))


@compiled
def _rate_range(y: Array, bounds: JointBounds) -> float:
    """Largest change of the rate along y (n,) in this control step, rad/s (m/s)."""
    return float(((bounds.reach_hi - bounds.reach_lo) / np.maximum(np.abs(y), 1e-9)).min())


@compiled
def continuing_rates(
    near: SingularDirections, rates: Array, first: int, last: int, previous: Array, bounds: JointBounds
) -> Array:
    """``rates`` (m,), those from ``first`` to ``last`` with the sign of the present motion ``previous`` (n,); at the
    singularity itself the sign of u and y is arbitrary."""
    rates = rates.copy()
    for index in range(first, last):
        y = near.rows[index]
        present = (y * previous).sum()
        if near.sigma[index] < near.tolerance and abs(present) > 0.2 * _rate_range(y, bounds):
            rates[index] = np.sign(present) * abs(rates[index])
    return rates


@compiled
def motion_of_others(near: SingularDirections, rates: Array, first: int) -> Array:
    """Joint velocities (n,) of ``rates`` (m,) without the critical directions."""
    motion = np.zeros(near.rows.shape[1])
    for index in range(first):
        motion += rates[index] * near.rows[index]
    return motion


@compiled
def directions_to_differentiate(near: SingularDirections, rates: Array, first: int) -> Array:
    """Unit vectors of the motion without the critical directions, of the whole motion, and of the k critical
    directions, (2 + k, n); zero for no motion."""
    size, n = near.rows.shape
    found = np.zeros((2 + size - first, n))
    found[0] = motion_of_others(near, rates, first)
    found[1] = motion_of_others(near, rates, size)
    found[2:] = near.rows[first:]
    for row in range(2):
        length = np.sqrt((found[row] ** 2).sum())
        found[row] *= 1.0 / length if length > MIN_MOTION else 0.0
    return found


@compiled
def analyse(
    near: SingularDirections, rates: Array, first: int, beside: Array, limits: MotionLimits
) -> DirectionFigures:
    """Figures of the critical directions at the ``rates`` (m,) that the twist requires.

    ``beside`` (2 + k, 2, m, n): :func:`jacobians_beside` the :func:`directions_to_differentiate`.
    """
    size = len(near.sigma)
    count = size - first
    min_sigma, distances, max_rates = np.empty(count), np.empty(count), np.empty(count)
    leaves = np.empty(count, np.bool_)
    others = motion_of_others(near, rates, first)
    speed = np.sqrt((others * others).sum())
    for row in range(count):
        index = first + row
        y, sigma, w, rate = near.rows[index], near.sigma[index], near.along[index], rates[index]
        magnitude = np.maximum(np.abs(y), 1e-9)
        max_rate = SPEED_FRACTION * (limits.velocity / magnitude).min()
        acceleration = ACCELERATION_FRACTION * (limits.acceleration / magnitude).min()
        growth = _growth(near, index, beside[2 + row])
        if sigma < 2.0 * near.tolerance:
            # A turn that makes the twist feasible has to end where it is.
            after = _twist_along(near, index, beside[2 + row, 0 if rate > 0.0 else 1]) if rate != 0.0 else abs(w)
            turn = abs(w) / max(-(after - abs(w)) / STEP, 1e-12)
            final = min(max_rate, viable_speed_at(turn, acceleration, limits.dt_max_s, limits.dt_max_s))
            max_rate = final + smoothstep(sigma / near.tolerance - 1.0) * (max_rate - final)
        min_sigma[row] = sigma * abs(w) / max(np.hypot(w, speed * _growth(near, index, beside[0])), 1e-30)
        # Half the tolerance is added because at a wrist the growth vanishes with sigma.
        distance = (sigma + 0.5 * near.tolerance) / max(abs(growth), 1e-12)
        distances[row] = smoothstep((distance - NEAR_BOUNDARY_RAD) / (FAR_FROM_BOUNDARY_RAD - NEAR_BOUNDARY_RAD))
        leaves[row] = growth * rate >= 0.0
        if not leaves[row]:
            margin = max(sigma - near.tolerance, 0.0) / max(abs(growth), 1e-12)
            approach = min(max_rate, viable_speed_at(margin, acceleration, limits.dt_max_s, limits.dt_max_s))
            max_rate = approach + distances[row] * (max_rate - approach)
        max_rates[row] = max_rate
    turn_scale = _acceleration_scale(near, rates, beside[1], limits)
    return DirectionFigures(min_sigma, distances, leaves, max_rates, turn_scale)


@compiled
def _growth(near: SingularDirections, index: int, beside: Array) -> float:
    """u' (d D J) y of one direction, per unit of the motion that ``beside`` (2, m, n) belongs to."""
    growth = 0.0
    for row in range(len(near.row_scale)):
        change = ((beside[0, row] - beside[1, row]) * near.rows[index]).sum()
        growth += near.u[row, index] * near.row_scale[row] * change
    return growth * (0.5 / STEP)


@compiled
def _scaled(near: SingularDirections, jacobian: Array) -> Array:
    scaled = np.empty(jacobian.shape)
    for row in range(len(near.row_scale)):
        scaled[row] = near.row_scale[row] * jacobian[row]
    return scaled


@compiled
def _twist_along(near: SingularDirections, index: int, jacobian: Array) -> float:
    """The twist |w| along direction ``index`` of another Jacobian (m, n)."""
    u, _, _ = np.linalg.svd(_scaled(near, jacobian), False)
    found = 0.0
    for row in range(len(near.row_scale)):
        found += u[row, index] * (near.u[row] * near.along).sum()
    return abs(found)


@compiled
def _velocity(near: SingularDirections, jacobian: Array) -> Array:
    """The exact joint velocities (n,) for the twist at another Jacobian (m, n)."""
    u, sigma, vt = np.linalg.svd(_scaled(near, jacobian), False)
    along = np.zeros(len(sigma))
    for row in range(len(near.row_scale)):
        along += u[row] * (near.u[row] * near.along).sum()
    rates = bounded_rates(sigma, along, near.tolerance)
    velocity = np.zeros(jacobian.shape[1])
    for index in range(len(rates)):
        velocity += rates[index] * vt[index]
    return velocity


@compiled
def _acceleration_scale(near: SingularDirections, rates: Array, beside: Array, limits: MotionLimits) -> float:
    """:attr:`DirectionFigures.turn_scale`; ``beside`` (2, m, n): Jacobians beside q along the motion."""
    speed = np.sqrt((motion_of_others(near, rates, len(rates)) ** 2).sum())
    if speed < 1e-9:
        return 1.0
    change = np.abs(_velocity(near, beside[0]) - _velocity(near, beside[1])) * (0.5 * speed / STEP)
    needed = (change / (ACCELERATION_FRACTION * limits.acceleration)).max()
    return float(1.0 / np.sqrt(max(1.0, needed)))


@compiled
def clip_rate(y: Array, rate: float, max_rate: float, motion: Array, previous: Array, bounds: JointBounds) -> float:
    """The rate of a truncated direction: the part that is feasible together with ``motion`` (n,), the other motion."""
    low, high = -np.inf, np.inf
    for joint in range(len(y)):
        if abs(y[joint]) > 1e-3:
            one = (bounds.lo[joint] - motion[joint]) / y[joint]
            other = (bounds.hi[joint] - motion[joint]) / y[joint]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    if low > high:
        present, half = (y * previous).sum(), 0.45 * _rate_range(y, bounds)
        low, high = present - half, present + half
    return float(min(max(np.sign(rate) * min(abs(rate), max_rate), low), high))

"""Analysis of the singular directions of a Jacobian: singular values, their derivatives, and feasible joint rates.

:mod:`ik_node.differential_ik.singularity` decides with these figures. Derivatives are central differences of the
Jacobian and of its decomposition: two evaluations of the kinematics each, and only near singularities.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ik_node.differential_ik.viable_scale import GROWTH, TURNING
from ik_node.math.numerics import smoothstep
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, viable_speed

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

JacobianAt = Callable[[Array], Array]
"""q (n,) -> J (6, n), rows not scaled."""


class JacobianNeighbourhood(NamedTuple):
    """The singular value decomposition D J = U S Y' at q, and finite differences around it."""

    jacobian_at: JacobianAt
    q: Array
    row_scale: Array
    u: Array
    sigma: Array
    rows: Array
    """Y', right singular vectors as rows."""
    along: Array
    """U' D V, the twist along each direction."""
    tolerance: float

    def rates(self, sigma: Array, along: Array) -> Array:
        """alpha: along / sigma, bounded by along / (tolerance / 2) at sigma = 0, with a continuous slope."""
        x = sigma / self.tolerance
        return np.asarray(along / np.where(x < 1.0, 0.5 * self.tolerance * (1.0 + x * x), sigma))

    def needs_no_regulation(self, rates: Array, limits: MotionLimits) -> bool:
        """True if the exact rates are feasible by bounds alone, without derivatives: rates are low, sigma is not.

        With C the longest column of D J, \\|dJ/dq qd qd\\| <= ``TURNING`` C \\|qd\\|^2 and
        \\|d sigma/d alpha\\| <= ``GROWTH`` C, with a margin on every arm that was tried.
        """
        smallest, margin = float(self.sigma[-1]), float(self.sigma[-1]) - self.tolerance
        if margin < self.tolerance:
            return False
        speed = float(np.sqrt(rates @ rates))
        if speed > SPEED_FRACTION * float(limits.velocity.min()):
            return False
        acceleration = ACCELERATION_FRACTION * float(limits.acceleration.min())
        column = float(np.sqrt((self.sigma[:, None] ** 2 * self.rows**2).sum(axis=0).max()))
        if TURNING * column * speed * speed > acceleration * smallest:
            return False
        return speed <= float(viable_speed(np.array([margin / (GROWTH * column)]), acceleration, limits.dt_max_s)[0])

    def derivative(self, direction: Array) -> Array:
        """Derivative of D J along ``direction`` (n,), per unit of it."""
        length = float(np.sqrt(direction @ direction))
        if length < 1e-12:
            return np.zeros((len(self.row_scale), len(direction)))
        step = (STEP / length) * direction
        difference = self.jacobian_at(self.q + step) - self.jacobian_at(self.q - step)
        return np.asarray(self.row_scale[:, None] * difference * (0.5 * length / STEP))

    def twist_after_step(self, index: int, side: float) -> float:
        """The twist |w| along direction ``index`` after a step along it."""
        scaled = self.row_scale[:, None] * self.jacobian_at(self.q + side * STEP * self.rows[index])
        u, _, _ = np.linalg.svd(scaled, full_matrices=False)
        return abs(float(u[:, index] @ (self.u @ self.along)))

    def velocity(self, q: Array, twist: Array) -> Array:
        """The exact joint velocities for the scaled twist D V at another q."""
        u, sigma, vt = np.linalg.svd(self.row_scale[:, None] * self.jacobian_at(q), full_matrices=False)
        return np.asarray(self.rates(sigma, u.T @ twist) @ vt)


class DirectionAnalysis(NamedTuple):
    """Figures of one singular direction."""

    min_sigma: float
    """sigma*: smallest sigma on the way if the arm continues straight on, m."""
    boundary_distance: float
    """Distance from a workspace boundary, scaled: 0 at the boundary, 1 far from it or where there is none."""
    leaves_boundary: bool
    """True if motion along the direction makes sigma grow."""
    max_rate: float
    """Highest rate along the direction, rad/s (m/s)."""


def analyse(
    near: JacobianNeighbourhood, index: int, rate: float, jacobian_rate: Array, limits: MotionLimits
) -> DirectionAnalysis:
    """Figures of direction ``index`` at the ``rate`` that the twist requires.

    ``jacobian_rate`` (6, n): derivative of D J along the motion in the other directions.
    """
    y, sigma, w = near.rows[index], float(near.sigma[index]), float(near.along[index])
    max_rate = SPEED_FRACTION * float(np.min(limits.velocity / np.maximum(np.abs(y), 1e-9)))
    growth = float(near.u[:, index] @ near.derivative(y) @ y)
    if sigma < 2.0 * near.tolerance:
        # A turn that makes the twist feasible has to end where it is.
        acceleration = ACCELERATION_FRACTION * float(np.min(limits.acceleration / np.maximum(np.abs(y), 1e-9)))
        change = (near.twist_after_step(index, float(np.sign(rate))) - abs(w)) / STEP
        turn = np.array([abs(w) / max(-change, 1e-12)])
        final_rate = min(max_rate, float(viable_speed(turn, acceleration, limits.dt_max_s)[0]))
        max_rate = final_rate + smoothstep(sigma / near.tolerance - 1.0) * (max_rate - final_rate)
    passing = float(near.u[:, index] @ jacobian_rate @ y)
    min_sigma = sigma * abs(w) / max(float(np.hypot(w, passing)), 1e-30)
    # Half the tolerance is added because at a wrist the growth vanishes with sigma.
    distance = (sigma + 0.5 * near.tolerance) / max(abs(growth), 1e-12)
    boundary_distance = smoothstep((distance - NEAR_BOUNDARY_RAD) / (FAR_FROM_BOUNDARY_RAD - NEAR_BOUNDARY_RAD))
    if growth * rate >= 0.0:
        return DirectionAnalysis(min_sigma, boundary_distance, True, max_rate)
    acceleration = ACCELERATION_FRACTION * float(np.min(limits.acceleration / np.maximum(np.abs(y), 1e-9)))
    margin = np.array([max(sigma - near.tolerance, 0.0) / max(abs(growth), 1e-12)])
    approach_rate = min(max_rate, float(viable_speed(margin, acceleration, limits.dt_max_s)[0]))
    return DirectionAnalysis(
        min_sigma, boundary_distance, False, approach_rate + boundary_distance * (max_rate - approach_rate)
    )


def rate_range(y: Array, bounds: JointBounds) -> float:
    """Largest change of the rate along y (n,) in this control step, rad/s (m/s)."""
    return float(np.min((bounds.reach_hi - bounds.reach_lo) / np.maximum(np.abs(y), 1e-9)))


def continuing_rate(
    near: JacobianNeighbourhood, index: int, rate: float, previous: Array, bounds: JointBounds
) -> float:
    """``rate`` with the sign of the present motion; at the singularity itself the sign of u and y is arbitrary."""
    y = near.rows[index]
    present = float(y @ previous)
    if near.sigma[index] < near.tolerance and abs(present) > 0.2 * rate_range(y, bounds):
        return float(np.sign(present)) * abs(rate)
    return rate


def clip_rate(
    near: JacobianNeighbourhood,
    index: int,
    rate: float,
    max_rate: float,
    motion: Array,
    previous: Array,
    bounds: JointBounds,
) -> float:
    """The rate of a truncated direction: the part that is feasible together with ``motion`` (n,), the other motion."""
    y = near.rows[index]
    wanted = float(np.sign(rate)) * min(abs(rate), max_rate)
    moved = np.abs(y) > 1e-3
    ends = np.stack((bounds.lo - motion, bounds.hi - motion))[:, moved] / y[moved]
    low, high = float(ends.min(axis=0).max()), float(ends.max(axis=0).min())
    if low > high:
        present, half = float(y @ previous), 0.45 * rate_range(y, bounds)
        low, high = present - half, present + half
    return min(max(wanted, low), high)


def acceleration_scale(near: JacobianNeighbourhood, rates: Array, limits: MotionLimits) -> float:
    """The factor <= 1 on V at which the joint accelerations of following V exactly are within their limits."""
    velocity = rates @ near.rows
    length = float(np.sqrt(velocity @ velocity))
    if length < 1e-9:
        return 1.0
    twist = near.u @ near.along
    step = (STEP / length) * velocity
    change = near.velocity(near.q + step, twist) - near.velocity(near.q - step, twist)
    needed = np.abs(change) * (0.5 * length / STEP) / (ACCELERATION_FRACTION * limits.acceleration)
    return float(1.0 / np.sqrt(max(1.0, float(needed.max()))))

"""What lies along the singular directions of a Jacobian: singular values, how they change, what the joints can do.

The parts that :mod:`ik_node.differential_ik.singularity` weighs. Derivatives are differences of the Jacobian and of its decomposition
around q: two evaluations of the kinematics each, and only near singularities.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, viable_speed

SPEED_PART = 0.9
"""Part of the joint speeds that a singular direction may use; the rest of the twist needs some too."""

ACCELERATION_PART = 0.7
"""Part of the joint accelerations that turning and slowing down count on."""

NEAR_BOUNDARY_RAD = 0.15
"""Nearer to a boundary than this (rad, or m for a prismatic joint) a direction is let go ..."""

FAR_FROM_BOUNDARY_RAD = 0.35
"""... further than this it is kept."""

TURNING, GROWTH = 1.5, 0.5
"""Bounds of derivatives of J; the largest seen on eight arms: 1.06 and 0.30."""

STEP = 1e-6
"""Of finite differences, rad (m)."""

JacobianAt = Callable[[Array], Array]
"""q (n,) -> J (6, n), unscaled."""


def smooth_step(x: float) -> float:
    """0 below 0, 1 above 1, smooth between."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


class Neighbourhood(NamedTuple):
    """The decomposition at q, and differences around it."""

    jacobian_at: JacobianAt
    q: Array
    row_scale: Array
    u: Array
    sigma: Array
    rows: Array
    along: Array
    """u' D V, (size,)."""
    tolerance: float

    def rates(self, sigma: Array, along: Array) -> Array:
        """alpha: along / sigma, bounded by along / (tolerance / 2) at sigma = 0 with a continuous slope."""
        x = sigma / self.tolerance
        return np.asarray(along / np.where(x < 1.0, 0.5 * self.tolerance * (1.0 + x * x), sigma))

    def easy(self, rates: Array, limits: MotionLimits) -> bool:
        """True where no derivative is needed to see that the exact rates can be had: they are low, sigma is not.

        With C the longest column of D J, \\|dJ/dq qd qd\\| <= ``TURNING`` C \\|qd\\|^2 and \\|d sigma/d alpha\\| <=
        ``GROWTH`` C, with room to spare on every arm that was tried.
        """
        smallest, left = float(self.sigma[-1]), float(self.sigma[-1]) - self.tolerance
        if left < self.tolerance:
            return False
        speed = float(np.sqrt(rates @ rates))
        if speed > SPEED_PART * float(limits.velocity.min()):
            return False
        slowest = ACCELERATION_PART * float(limits.acceleration.min())
        column = float(np.sqrt((self.sigma[:, None] ** 2 * self.rows**2).sum(axis=0).max()))
        if TURNING * column * speed * speed > slowest * smallest:
            return False
        return speed <= float(viable_speed(np.array([left / (GROWTH * column)]), slowest, limits.dt_max_s)[0])

    def change(self, direction: Array) -> Array:
        """Derivative of D J along ``direction`` (n,), per unit of it."""
        length = float(np.sqrt(direction @ direction))
        if length < 1e-12:
            return np.zeros((len(self.row_scale), len(direction)))
        step = (STEP / length) * direction
        difference = self.jacobian_at(self.q + step) - self.jacobian_at(self.q - step)
        return np.asarray(self.row_scale[:, None] * difference * (0.5 * length / STEP))

    def remaining(self, index: int, side: float) -> float:
        """|w| of this direction after a step along it."""
        there = self.row_scale[:, None] * self.jacobian_at(self.q + side * STEP * self.rows[index])
        u, _, _ = np.linalg.svd(there, full_matrices=False)
        return abs(float(u[:, index] @ (self.u @ self.along)))

    def velocity(self, q: Array, twist: Array) -> Array:
        """The exact joint velocities for D V at another q."""
        u, sigma, vt = np.linalg.svd(self.row_scale[:, None] * self.jacobian_at(q), full_matrices=False)
        return np.asarray(self.rates(sigma, u.T @ twist) @ vt)


class View(NamedTuple):
    """What lies along one direction."""

    closest: float
    """sigma*, m."""
    inside: float
    """0 at a boundary, 1 far from it or where there is none."""
    leaving: bool
    """True where motion along it makes sigma grow."""
    most: float
    """The highest rate along it, rad/s (m/s)."""


def look(near: Neighbourhood, index: int, rate: float, drift: Array, limits: MotionLimits) -> View:
    """The view along direction ``index`` at the ``rate`` asked for; ``drift``: what the other motion does to D J."""
    y, sigma, w = near.rows[index], float(near.sigma[index]), float(near.along[index])
    most = SPEED_PART * float(np.min(limits.velocity / np.maximum(np.abs(y), 1e-9)))
    growth = float(near.u[:, index] @ near.change(y) @ y)
    if sigma < 2.0 * near.tolerance:
        # A turn that brings the twist within reach has to end there.
        acceleration = ACCELERATION_PART * float(np.min(limits.acceleration / np.maximum(np.abs(y), 1e-9)))
        away = (near.remaining(index, float(np.sign(rate))) - abs(w)) / STEP
        turn = np.array([abs(w) / max(-away, 1e-12)])
        ending = min(most, float(viable_speed(turn, acceleration, limits.dt_max_s)[0]))
        most = ending + smooth_step(sigma / near.tolerance - 1.0) * (most - ending)
    passing = float(near.u[:, index] @ drift @ y)
    closest = sigma * abs(w) / max(float(np.hypot(w, passing)), 1e-30)
    # Half the tolerance: at a wrist h goes to zero with sigma.
    distance = (sigma + 0.5 * near.tolerance) / max(abs(growth), 1e-12)
    inside = smooth_step((distance - NEAR_BOUNDARY_RAD) / (FAR_FROM_BOUNDARY_RAD - NEAR_BOUNDARY_RAD))
    if growth * rate >= 0.0:
        return View(closest, inside, True, most)
    acceleration = ACCELERATION_PART * float(np.min(limits.acceleration / np.maximum(np.abs(y), 1e-9)))
    left = np.array([max(sigma - near.tolerance, 0.0) / max(abs(growth), 1e-12)])
    landing = min(most, float(viable_speed(left, acceleration, limits.dt_max_s)[0]))
    return View(closest, inside, False, landing + inside * (most - landing))


def room(y: Array, bounds: JointBounds) -> float:
    """How much the rate along y can change at this tick, rad/s (m/s)."""
    return float(np.min((bounds.reach_hi - bounds.reach_lo) / np.maximum(np.abs(y), 1e-9)))


def same_side(near: Neighbourhood, index: int, rate: float, previous: Array, bounds: JointBounds) -> float:
    """At the singularity itself the sign of u and y is chance: the arm goes on turning the way it turns."""
    y = near.rows[index]
    now = float(y @ previous)
    if near.sigma[index] < near.tolerance and abs(now) > 0.2 * room(y, bounds):
        return float(np.sign(now)) * abs(rate)
    return rate


def clip(
    near: Neighbourhood, index: int, rate: float, most: float, motion: Array, previous: Array, bounds: JointBounds
) -> float:
    """The rate of a direction that is let go: what the box leaves beside the rest of the motion."""
    y = near.rows[index]
    wanted = float(np.sign(rate)) * min(abs(rate), most)
    moved = np.abs(y) > 1e-3
    ends = np.stack((bounds.lo - motion, bounds.hi - motion))[:, moved] / y[moved]
    low, high = float(ends.min(axis=0).max()), float(ends.max(axis=0).min())
    if low > high:
        now, half = float(y @ previous), 0.45 * room(y, bounds)
        low, high = now - half, now + half
    return min(max(wanted, low), high)


def slow_enough(near: Neighbourhood, rates: Array, limits: MotionLimits) -> float:
    """The pace at which the joint accelerations of following V exactly are within their limits."""
    velocity = rates @ near.rows
    length = float(np.sqrt(velocity @ velocity))
    if length < 1e-9:
        return 1.0
    twist = near.u @ near.along
    step = (STEP / length) * velocity
    change = near.velocity(near.q + step, twist) - near.velocity(near.q - step, twist)
    needed = np.abs(change) * (0.5 * length / STEP) / (ACCELERATION_PART * limits.acceleration)
    return float(1.0 / np.sqrt(max(1.0, float(needed.max()))))

"""Foresight: the largest scale of the twist at which the joints can still brake along its direction.

The bounds of one control step act too late: where the joint rates that V requires grow (near a singularity, where J
turns quickly) or end (at a position limit), joints that have to decelerate at different rates leave the direction of
V. As position limits have a viable speed, so has the direction: the straight motion q(sigma) at the twist V is
predicted, dq/dsigma = p(q), and with the scale s = dsigma/dt and x = s^2 the joints need ::

    speed         |p_i| s                    <= vmax_i
    acceleration  |p'_i x + p_i ds/dt|       <= a_i        p' = dp/dsigma

The largest x of the present position from which every position ahead can be passed, or reached at rest, follows by one
pass from the end of the horizon to its begin (H. Pham, Q.-C. Pham, "A New Approach to Time-Optimal Path
Parameterization Based on Reachability Analysis", IEEE T-RO 2018).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.chain import damped_rates, moved_chain, relative_speeds
from ik_node.robot.joint_limits import MotionLimits, viable_speed_at

ACCELERATION_FRACTION = 0.8
"""Fraction of the joint accelerations that following and braking may use; changes of V need the rest."""

NODES = 10
"""Intervals of the prediction."""

HORIZON = 1.6
"""Length of the prediction relative to the braking distance at constant joint rates."""

MIN_VIABLE_SCALE = 0.02
"""Below this scale the limits of the control step alone decide, so that the status names them and a deadlock ends."""

MIN_RATE = 1e-9
"""Joint rates below this, rad/s (m/s), count as zero."""

DAMPING = 0.3
"""Damping of the predicted joint velocities, relative to the tolerance, where every direction is kept."""

TURNING, GROWTH = 1.5, 0.5
"""Bounds of derivatives of J; the largest on eight arms: 1.06 and 0.30."""


class Prediction(NamedTuple):
    """What the twist requires of the joints, now and ahead."""

    jacobian: Array
    """Body Jacobian J at q, (6, n), with the columns in the order of ``order``."""
    order: NDArray[np.int64]
    """Indices of the joints from the base to the tool, (n,)."""
    row_scale: Array
    """D, (6,)."""
    twist: Array
    """V, (6,), in {b}."""
    tolerance: float
    """Rates are bounded below this singular value, as in :mod:`ik_node.differential_ik.singularity`."""
    kept: Array
    """Factor on the rate along each singular direction, (6,)."""


@compiled
def required_rates(p: Prediction, change: Array, speeds: Array) -> Array:
    """Joint velocities (n,) that the twist requires after a change of the joint positions (n,)."""
    jacobian, _ = moved_chain(p.jacobian, p.order, change)
    if p.kept.min() == 1.0:
        return damped_rates(jacobian, p.twist, p.row_scale, DAMPING * p.tolerance, speeds)
    twist = p.twist * p.row_scale
    for row in range(6):
        jacobian[row] *= p.row_scale[row]
    u, sigma, vt = np.linalg.svd(jacobian, False)
    along, rates = twist @ u, np.empty(len(sigma))
    for i in range(len(sigma)):
        x = sigma[i] / p.tolerance
        least = sigma[i] if x >= 1.0 else 0.5 * p.tolerance * (1.0 + x * x)
        rates[i] = p.kept[i] * along[i] / least
    return np.asarray(rates @ vt)


@compiled
def viable_scale(p: Prediction, q: Array, previous: Array, limits: MotionLimits) -> float:
    """The largest s in [0, 1] at which the arm can still brake along the direction of the twist.

    Args:
        p: What the twist requires.
        q: Joint positions, (n,), rad (m).
        previous: The present command, (n,), rad/s (m/s).
        limits: Limits of the joints.
    """
    change, n, speeds = np.zeros(len(q)), len(q), relative_speeds(limits.velocity)
    rates = np.empty((NODES + 1, n))
    rates[0] = required_rates(p, change, speeds)
    length, u, s, ahead = horizon(rates[0], q, previous, limits)
    if u == 0.0:
        return 1.0
    step, count = length / NODES, NODES
    for k in range(NODES):
        middle = rates[k] if k == 0 else 1.5 * rates[k] - 0.5 * rates[k - 1]
        change = change + step * middle
        rates[k + 1] = required_rates(p, change, speeds)
        for i in range(n if n <= 6 else 0):
            position = q[i] + change[i]
            if (position > limits.upper[i] and middle[i] > 0.0) or (position < limits.lower[i] and middle[i] < 0.0):
                count = min(count, k + 1)
        if count < NODES:
            break
    x = largest_square(rates[: count + 1], step, limits.velocity, ACCELERATION_FRACTION * limits.acceleration)
    found = max(min(np.sqrt(x), ahead), MIN_VIABLE_SCALE)
    return 1.0 if found >= s else found


@compiled
def horizon(p: Array, q: Array, previous: Array, limits: MotionLimits) -> tuple[float, float, float, float]:
    """Length of the prediction, deceleration of s, greatest next s, and the s that position limits permit."""
    u, distance, along, square = np.inf, np.inf, 0.0, 0.0
    for i in range(len(p)):
        rate = abs(p[i])
        along += p[i] * previous[i]
        square += p[i] * p[i]
        if rate > MIN_RATE:
            u = min(u, ACCELERATION_FRACTION * limits.acceleration[i] / rate)
            if len(p) <= 6:
                room = limits.upper[i] - q[i] if p[i] > 0.0 else q[i] - limits.lower[i]
                distance = min(distance, max(room, 0.0) / rate)
    if square == 0.0 or not np.isfinite(u):
        return 0.0, 0.0, 1.0, 1.0
    tick = limits.dt_max_s
    s = min(1.0, max(0.0, along / square) + u * tick / ACCELERATION_FRACTION)
    length = HORIZON * (0.5 * s * s / u + s * tick)
    return length, u, s, min(1.0, viable_speed_at(distance, u, tick, tick))


@compiled
def needs_foresight(p: Array, jacobian: Array, smallest: float, q: Array, limits: MotionLimits) -> bool:
    """False if bounds alone show that the arm can brake along the direction from full speed.

    With C the longest column of D J, \\|dJ/dq p\\| <= ``TURNING`` C \\|p\\| on every arm that was tried, so that
    \\|p'\\| <= ``TURNING`` C \\|p\\|^2 / sigma, and sigma changes by ``GROWTH`` C at most per unit of the joint motion.

    Args:
        p: Joint velocities that the twist requires, (n,).
        jacobian: D J, (6, n).
        smallest: Smallest singular value of D J.
        q: Joint positions, (n,).
        limits: Limits of the joints.
    """
    braking_s, speed, weakest = 0.0, 0.0, np.inf
    for i in range(len(p)):
        speed += p[i] * p[i]
        weakest = min(weakest, limits.acceleration[i])
        braking_s = max(braking_s, abs(p[i]) / (ACCELERATION_FRACTION * limits.acceleration[i]))
    length = HORIZON * (0.5 * braking_s + limits.dt_max_s)
    for i in range(len(p)):
        ahead = q[i] + length * p[i]
        if ahead > limits.upper[i] or ahead < limits.lower[i]:
            return True
    column = 0.0
    for i in range(len(p)):
        column = max(column, float(np.sqrt((jacobian[:, i] ** 2).sum())))
    ahead = smallest - GROWTH * column * np.sqrt(speed) * length
    return bool(TURNING * column * speed > (1.0 - ACCELERATION_FRACTION) * weakest * ahead)


@compiled
def largest_square(p: Array, step: float, velocity: Array, acceleration: Array) -> float:
    """The largest x = s^2 at the begin of a path from which it can be followed to rest at its end.

    Args:
        p: dq/dsigma at equally spaced places, (k + 1, n).
        step: Their spacing, s.
        velocity: (n,), rad/s (m/s).
        acceleration: (n,), rad/s2 (m/s2).
    """
    n, best = p.shape[1], 0.0
    a, b = np.empty(n + 1), np.empty(n + 1)
    for k in range(len(p) - 2, -1, -1):
        x, count = 1.0, 0
        for i in range(n):
            rate, change = 0.5 * (p[k, i] + p[k + 1, i]), (p[k + 1, i] - p[k, i]) / step
            if abs(p[k, i]) > velocity[i]:
                x = min(x, (velocity[i] / abs(p[k, i])) ** 2)
            if abs(rate) > MIN_RATE:  # |u + b x| <= a
                a[count], b[count] = acceleration[i] / abs(rate), change / rate
                count += 1
            elif abs(change) > MIN_RATE:
                x = min(x, acceleration[i] / abs(change))
        slope = 0.5 / step
        for i in range(count):
            for j in range(count):
                if b[i] - b[j] > 0.0:
                    x = min(x, (a[i] + a[j]) / (b[i] - b[j]))
            if slope - b[i] > 0.0:  # x + 2 step u <= best
                x = min(x, (slope * best + a[i]) / (slope - b[i]))
            if b[i] - slope > 0.0:  # x + 2 step u >= 0
                x = min(x, a[i] / (b[i] - slope))
        best = x
    return best

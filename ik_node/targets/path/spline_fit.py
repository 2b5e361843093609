"""Spline fit: velocities and accelerations at the given poses of a path.

Positions: the C2 cubic spline of least bending. Rotations: McEnnan's rotation spline, as in
``scipy.spatial.transform.RotationSpline``: a cubic theta(u) in each interval, with the angular velocities at the knots
from a tridiagonal system whose non-linear part is moved to the right side and iterated. The motion is C2 even without
convergence (by :class:`ik_node.targets.path.se3_spline.RigidSpline`); the iteration converges for turns of up to about
150 degrees per interval.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg import solve_banded

from ik_node.math.quaternion import Quaternion
from ik_node.math.so3 import inverse_right_jacobian, relative_rotation_vectors, right_jacobian, right_jacobian_rate
from ik_node.math.types import Array
from ik_node.targets.path.se3_spline import Knots

ITERATIONS = 8
"""Largest number of iterations of the system of the rotations."""
SETTLED = 1e-9
"""Change of the angular velocities [rad/s] below which the iteration ends."""
REPEATED = 1e-9
"""Poses closer to each other than this [m, rad] are equal."""


def through_poses(
    times_s: Array,
    positions: Array,
    orientations: tuple[Quaternion, ...],
    moving_start: bool = False,
    moving_end: bool = False,
) -> Knots:
    """Fits a spline through poses; it rests at both ends and at repeated poses.

    Args:
        times_s: Times (N,), increasing, N >= 2.
        positions: Positions (N, 3) [m].
        orientations: N unit quaternions (w, x, y, z).
        moving_start: True if it does not rest at the start; the velocity then follows from the first three poses.
        moving_end: The same for the end.

    Returns:
        The knots with velocities and accelerations.
    """
    count = len(times_s)
    turns = relative_rotation_vectors(orientations)
    velocities, accelerations = np.zeros((count, 3)), np.zeros((count, 3))
    rates, angular = np.zeros((count, 3)), np.zeros((count, 3))
    still = (np.abs(np.diff(positions, axis=0)).max(axis=1) < REPEATED) & (np.abs(turns).max(axis=1) < REPEATED)
    rests = np.zeros(count, dtype=bool)
    rests[:-1] |= still
    rests[1:] |= still
    rests[[0, -1]] = True
    stops = np.flatnonzero(rests).tolist()
    steps, moves = np.diff(times_s), np.diff(positions, axis=0)
    for begin, end in pairwise(stops):
        free = (moving_start and begin == 0 and not still[0], moving_end and end == count - 1 and not still[-1])
        part = slice(begin, end)
        inner = slice(begin, end + 1)
        straight = np.zeros_like(
            moves[part]
        )  # theta = 0: J = 1, which turns the system of the rotations into that of the positions
        velocities[inner], accelerations[inner] = _least_bending(steps[part], moves[part], straight, free)
        rates[inner], angular[inner] = _least_bending(steps[part], turns[part], turns[part], free)
    return Knots(times_s, positions, orientations, velocities, rates, accelerations, angular)


def _least_bending(steps: Array, ways: Array, turns: Array, free: tuple[bool, bool]) -> tuple[Array, Array]:
    """Rates and their derivatives (N + 1, 3) at the knots of one piece; it rests at the ends that are not ``free``."""
    count = len(steps)
    h = steps[:, None]
    slopes = ways / h
    rates = np.zeros((count + 1, 3))
    for end, beside, is_free in ((0, 1, free[0]), (-1, -2, free[1])):
        if is_free:
            part = 0.0 if count == 1 else steps[end] / (steps[end] + steps[beside])
            rates[end] = slopes[end] + part * (slopes[end] - slopes[beside if count > 1 else end])
    weights = 1.0 / steps
    for _ in range(ITERATIONS):
        ends = inverse_right_jacobian(turns, rates[1:])
        right = 3.0 * (slopes[:-1] / h[:-1] + slopes[1:] / h[1:])
        right -= (right_jacobian(turns[:-1], rates[:-2]) - rates[:-2]) / h[:-1]
        right -= (ends[1:] - rates[2:]) / h[1:]
        right -= 0.5 * right_jacobian_rate(turns[:-1], ends[:-1], ends[:-1])
        renewed = _inner_rates(weights, right, rates[0] / h[0], rates[-1] / h[-1])
        change = float(np.abs(renewed - rates[1:-1]).max(initial=0.0))
        rates[1:-1] = renewed
        if change < SETTLED or not turns.any():
            break
    ends = inverse_right_jacobian(turns, rates[1:])
    first = (6.0 * slopes - 4.0 * rates[:-1] - 2.0 * ends) / h
    last = (-6.0 * slopes + 2.0 * rates[:-1] + 4.0 * ends) / h
    last = right_jacobian(turns, last) + right_jacobian_rate(turns, ends, ends)
    derivatives = np.zeros((count + 1, 3))
    derivatives[1:-1] = 0.5 * (last[:-1] + first[1:])
    if free[0]:
        derivatives[0] = first[0]
    if free[1]:
        derivatives[-1] = last[-1]
    return rates, derivatives


def _inner_rates(weights: Array, right: Array, first: Array, last: Array) -> Array:
    """The inner unknowns (N - 1, 3) of the system of a cubic spline, given the outer ones times their weights.

    w_(i-1) m_(i-1) + 2 (w_(i-1) + w_i) m_i + w_i m_(i+1) = r_i with w = 1 / h (N,); ``first`` is w_0 m_0, ``last``
    w_(N-1) m_N.
    """
    if not len(right):
        return right
    shifted = right.copy()
    shifted[0] -= first
    shifted[-1] -= last
    bands = np.zeros((3, len(right)))
    bands[0, 1:] = bands[2, :-1] = weights[1:-1]
    bands[1] = 2.0 * (weights[:-1] + weights[1:])
    return np.asarray(solve_banded((1, 1), bands, shifted, overwrite_ab=True, overwrite_b=True, check_finite=False))


def estimated_accelerations(knots: Knots) -> Knots:
    """Accelerations from poses and velocities.

    They are those of the polynomial of degree 5 through each knot and its neighbours, an approximation of fourth order.
    At an end at rest they are 0, at another end those of the adjacent cubic.

    Args:
        knots: Knots with poses and velocities.

    Returns:
        The knots with accelerations.
    """
    steps, moves = np.diff(knots.times_s), np.diff(knots.positions, axis=0)
    turns = relative_rotation_vectors(knots.orientations)
    backward = inverse_right_jacobian(-turns, knots.rates[:-1])
    forward = inverse_right_jacobian(turns, knots.rates[1:])
    accelerations = _central(steps, moves, knots.velocities, knots.velocities[:-1], knots.velocities[1:])
    angular = _central(steps, turns, knots.rates, backward, forward)
    for end in (0, -1):
        if not knots.velocities[end].any() and not knots.rates[end].any():
            accelerations[end], angular[end] = 0.0, 0.0
    return knots._replace(accelerations=accelerations, angular_accelerations=angular)


def _central(steps: Array, ways: Array, rates: Array, before: Array, after: Array) -> Array:
    """Second derivatives (N, 3) at the knots, in the tangent of each.

    ``ways`` (N - 1, 3) from knot to knot, ``rates`` (N, 3) at the knots, ``before`` and ``after`` (N - 1, 3) at the
    neighbours, seen in the knot's tangent.
    """
    count = len(rates)
    result = np.empty((count, 3))
    h = steps[:, None]
    result[0] = ((6.0 * ways / h - 4.0 * rates[:-1] - 2.0 * after) / h)[0]
    result[-1] = ((-6.0 * ways / h + 2.0 * before + 4.0 * rates[1:]) / h)[-1]
    # x(u) = rate u + c2 u^2 + ... + c5 u^5 meets way and rate at u = -left and u = right; u in parts of right
    ratio = -(steps[:-1] / steps[1:])[:, None]
    powers = np.arange(2.0, 6.0)
    system = np.empty((count - 2, 4, 4))
    system[:, 0], system[:, 1] = 1.0, powers
    system[:, 2], system[:, 3] = ratio**powers, powers * ratio ** (powers - 1.0)
    inner, right = rates[1:-1], h[1:]
    wanted = np.stack(
        (
            ways[1:] - right * inner,
            right * (after[1:] - inner),
            -ways[:-1] - ratio * right * inner,
            right * (before[:-1] - inner),
        ),
        axis=1,
    )
    result[1:-1] = 2.0 * np.linalg.solve(system, wanted)[:, 0] / right**2
    return result

"""How fast a smooth motion passes the poses that it was given.

Positions: the C2 cubic spline, of least bending. Rotations: McEnnan's rotation spline, the one of
``scipy.spatial.transform.RotationSpline``: in each interval a cubic theta(u), with the knots' angular velocities from a
tridiagonal system whose non-linear part is put on its right side and repeated. That repetition need not converge for
the motion to be C2 (:class:`ik_node.targets.path.se3_spline.RigidSpline` sees to that); it settles for turns of up to
about 150 degrees in each interval.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ik_node.math.quaternion import Quaternion
from ik_node.math.so3 import inverse_right_jacobian, relative_rotation_vectors, right_jacobian, right_jacobian_rate
from ik_node.math.types import Array
from ik_node.targets.path.se3_spline import Knots

ITERATIONS = 8
"""How often the non-linear part of the rotations' system is renewed at most."""
SETTLED = 1e-9
"""Largest change of angular velocities [rad/s] at which it is settled."""
REPEATED = 1e-9
"""Poses nearer to each other than this [m, rad] are the same one."""


def through_poses(
    times_s: Array,
    positions: Array,
    orientations: tuple[Quaternion, ...],
    moving_start: bool = False,
    moving_end: bool = False,
) -> Knots:
    """Knots of the spline through poses: at rest at its ends and wherever a pose is repeated.

    ``moving_start``, ``moving_end``: it is under way there instead, as the three poses nearest to that end say.
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
        straight = np.zeros_like(moves[part])  # theta = 0: J = 1, which makes the rotations' system that of positions
        velocities[inner], accelerations[inner] = _least_bending(steps[part], moves[part], straight, free)
        rates[inner], angular[inner] = _least_bending(steps[part], turns[part], turns[part], free)
    return Knots(times_s, positions, orientations, velocities, rates, accelerations, angular)


def _least_bending(steps: Array, ways: Array, turns: Array, free: tuple[bool, bool]) -> tuple[Array, Array]:
    """Rates and their derivatives (N + 1, 3) at the knots of one piece, at rest at ends not ``free``."""
    count = len(steps)
    h = steps[:, None]
    slopes = ways / h
    rates = np.zeros((count + 1, 3))
    for end, beside, is_free in ((0, 1, free[0]), (-1, -2, free[1])):
        if is_free:
            part = 0.0 if count == 1 else steps[end] / (steps[end] + steps[beside])
            rates[end] = slopes[end] + part * (slopes[end] - slopes[beside if count > 1 else end])
    solver = _Tridiagonal(1.0 / steps)
    for _ in range(ITERATIONS):
        ends = inverse_right_jacobian(turns, rates[1:])
        right = 3.0 * (slopes[:-1] / h[:-1] + slopes[1:] / h[1:])
        right -= (right_jacobian(turns[:-1], rates[:-2]) - rates[:-2]) / h[:-1]
        right -= (ends[1:] - rates[2:]) / h[1:]
        right -= 0.5 * right_jacobian_rate(turns[:-1], ends[:-1], ends[:-1])
        renewed = solver.solve(right, rates[0] / h[0], rates[-1] / h[-1])
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


class _Tridiagonal:
    """The system w_(i-1) m_(i-1) + 2 (w_(i-1) + w_i) m_i + w_i m_(i+1) = r_i of a cubic spline, w = 1 / h, with the
    first and the last m given."""

    def __init__(self, weights: Array) -> None:
        self._weights: list[float] = weights.tolist()
        self._upper: list[float] = []
        self._pivots: list[float] = []
        before = 0.0
        for left, right in zip(self._weights, self._weights[1:], strict=False):
            pivot = 2.0 * (left + right) - left * before
            before = right / pivot
            self._pivots.append(pivot)
            self._upper.append(before)

    def solve(self, right: Array, first: Array, last: Array) -> Array:
        """The inner unknowns (N - 1, 3); ``first`` and ``last`` are the outer ones times their weights."""
        shifted = right.copy()
        if len(shifted):
            shifted[0] -= first
            shifted[-1] -= last
        columns = [self._column(column) for column in shifted.T.tolist()]
        return np.asarray(np.array(columns).T.reshape(-1, 3))

    def _column(self, right: list[float]) -> list[float]:
        forward, value = [], 0.0
        for weight, pivot, entry in zip(self._weights, self._pivots, right, strict=False):
            value = (entry - weight * value) / pivot
            forward.append(value)
        solution, value = [], 0.0
        for entry, upper in zip(reversed(forward), reversed(self._upper), strict=True):
            value = entry - upper * value
            solution.append(value)
        return solution[::-1]


def estimated_accelerations(knots: Knots) -> Knots:
    """``knots`` with accelerations where only poses and rates are known: those of the polynomial of degree 5 through
    each knot and its neighbours, right to the fourth order of their distance. At an end that rests they are 0, at
    another one those of the cubic beside it.
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

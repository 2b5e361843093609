"""The program of :mod:`ik_node.differential_ik.constrained` for null spaces of dimension 0 and 1: exact, compiled.

::

    qd = qd_0 + (s - s_0) p + Z' z ,        alpha s + zeta z <= beta ,  0 <= s <= 1

p is the joint velocity that gives the twist, Z a basis of the null space (rows). A six-joint arm has no z, and the
largest s is a smallest ratio. A seven-joint arm has one z: it is eliminated from every pair of rows (Fourier-Motzkin),
and an interval remains for it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.pseudoinverse import EPSILON, Decomposition
from ik_node.math.types import Array

ROUNDING = 1e-12
"""Differences up to this one are rounding."""

MIN_SLOPE = 1e-9
"""Rows that depend on z by no more than this do not limit it: a joint that the null space hardly moves gains nothing
from any z, and rounding divided by its slope would decide z. They are exceeded by at most this times z, and clipped."""

BINDING = 1e-12
"""Distance to a bound within which it counts as active, rad/s (m/s); answers are clipped to the bounds."""

MAX_BINDING = 1e-10
"""The same near singularities, where rounding is larger."""

DAMPER_BINDING = 1e-9
"""The same for a velocity damper, whose row has unit length."""


class LinearProgram(NamedTuple):
    """The rows ``alpha`` s + ``zeta`` z <= ``beta``; (r,), (r, d), (r,)."""

    alpha: Array
    zeta: Array
    beta: Array
    rounding: float = ROUNDING
    """A row that s = 1 exceeds by no more than this does not limit s."""


class NullSpaceCost(NamedTuple):
    """The cost 1/2 z' ``hessian`` z + (``slope`` + s ``change``)' z; (d, d) positive definite, (d,), (d,)."""

    hessian: Array
    slope: Array
    change: Array


class TaskLine(NamedTuple):
    """The joint velocities s p + Z' z, which move the tool along the twist."""

    ray: Array
    """p, (n,), rad/s (m/s)."""
    null: Array
    """Z, (d, n)."""
    rounding: float
    """Accuracy of p, rad/s (m/s)."""


class ProgramSolution(NamedTuple):
    """A solution; ``scale`` is NaN if the box contains no point of the task line."""

    joint_velocity: Array
    """(n,), not yet clipped to the box."""
    scale: float
    """s."""
    base_velocity: Array
    """qd_0, (n,)."""
    base_scale: float
    """s_0."""
    fallback: bool
    """True if the solver failed and the closed form was shortened instead."""


@compiled
def solve_exactly(
    line: TaskLine,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    base: Array,
    base_scale: float,
    weight: Array,
    pull: Array,
    free: Array,
    wish: float,
) -> ProgramSolution:
    """The optimum for a null space of dimension 0 or 1.

    Args:
        line: The task line.
        lo: Lower ends of the box, (n,), rad/s (m/s).
        hi: Upper ends of the box, (n,).
        rows: Velocity dampers ``rows`` qd >= ``least``, (k, n), of unit length.
        least: (k,).
        base: qd_0, (n,), inside box and dampers.
        base_scale: s_0 of ``base``; NaN if the first point of the line inside the box is to be computed.
        weight: W, (n, n), or (0, 0) for the identity.
        pull: Linear term of the cost 1/2 qd' W qd + pull' qd, (n,).
        free: The closed form, (n,); returned if there is no solution.
        wish: The scale s that is approached as far as box and dampers permit, 0 to 1.
    """
    if np.isnan(base_scale):
        base_scale, z = smallest_scale(
            program_along(line.ray, line.null, np.zeros(len(lo)), lo, hi, rows, least, ROUNDING)
        )
        if np.isnan(base_scale):
            return ProgramSolution(free, np.nan, base, np.nan, False)
        base = np.minimum(np.maximum(base_scale * line.ray + z @ line.null, lo), hi)
    direction = (wish - base_scale) * line.ray
    program = feasible_at_base(program_along(direction, line.null, base, lo, hi, rows, least, line.rounding))
    ratio, z = largest_scale(program, cost_along(line.null, weight, base, direction, pull))
    qd = base + ratio * direction + z @ line.null
    return ProgramSolution(qd, base_scale + ratio * (wish - base_scale), base, base_scale, False)


@compiled
def largest_scale(program: LinearProgram, cost: NullSpaceCost) -> tuple[float, Array]:
    """The largest s, and the z of least ``cost`` at that s."""
    if len(cost.slope) == 0:
        return smallest_ratio(program.alpha, program.beta, program.rounding), np.zeros(0)
    alpha, beta = _without_z(program)
    s = smallest_ratio(alpha, beta, program.rounding)
    lowest, highest = _interval(program, s)
    z = -(cost.slope[0] + s * cost.change[0]) / cost.hessian[0, 0]
    z = 0.5 * (lowest + highest) if lowest > highest else min(max(z, lowest), highest)
    return s, np.array([z])


@compiled
def smallest_ratio(alpha: Array, beta: Array, rounding: float) -> float:
    """The largest s in [0, 1] with ``alpha`` s <= ``beta``, where beta >= 0."""
    s = 1.0
    for i in range(len(alpha)):
        if alpha[i] > beta[i] + rounding:
            s = min(s, beta[i] / alpha[i])
    return s


@compiled
def _without_z(program: LinearProgram) -> tuple[Array, Array]:
    """The constraints on s alone (Fourier-Motzkin elimination): rows without z, and pairs of rows combined.

    Row i, which bounds z from above, and row j, which bounds it from below, are each multiplied by the other's |zeta|.
    """
    alpha, zeta, beta = program.alpha, program.zeta[:, 0], program.beta
    size = len(beta) + len(beta) * len(beta) // 4
    combined_alpha, combined_beta, count = np.empty(size), np.empty(size), 0
    for i in range(len(beta)):
        if zeta[i] > MIN_SLOPE:
            for j in range(len(beta)):
                if zeta[j] < -MIN_SLOPE:
                    sum_of_sizes = zeta[i] - zeta[j]
                    combined_alpha[count] = (zeta[i] * alpha[j] - zeta[j] * alpha[i]) / sum_of_sizes
                    combined_beta[count] = (zeta[i] * beta[j] - zeta[j] * beta[i]) / sum_of_sizes
                    count += 1
        elif zeta[i] >= -MIN_SLOPE:
            combined_alpha[count], combined_beta[count] = alpha[i], beta[i]
            count += 1
    return combined_alpha[:count], combined_beta[:count]


@compiled
def _interval(program: LinearProgram, s: float) -> tuple[float, float]:
    """The interval of z at this s."""
    lowest, highest = -np.inf, np.inf
    for i in range(len(program.beta)):
        zeta, margin = program.zeta[i, 0], program.beta[i] - program.alpha[i] * s
        if zeta > MIN_SLOPE:
            highest = min(highest, margin / zeta)
        elif zeta < -MIN_SLOPE:
            lowest = max(lowest, margin / zeta)
    return lowest, highest


@compiled
def smallest_scale(program: LinearProgram) -> tuple[float, Array]:
    """The smallest s in [0, 1] that is feasible with some z, and such a z; NaN if there is none.

    Here ``beta`` may be negative: s = 0, z = 0 may be infeasible.
    """
    if program.zeta.shape[1] == 0:
        return _smallest_s(program.alpha, program.beta, program.rounding), np.zeros(0)
    alpha, beta = _without_z(program)
    s = _smallest_s(alpha, beta, program.rounding)
    lowest, highest = _interval(program, s)
    middle = 0.5 * (lowest + highest)
    return s, np.array([middle if np.isfinite(middle) else 0.0])


@compiled
def _smallest_s(alpha: Array, beta: Array, rounding: float) -> float:
    """The smallest s in [0, 1] with ``alpha`` s <= ``beta``; NaN if there is none."""
    smallest, largest = 0.0, 1.0
    for i in range(len(alpha)):
        if beta[i] < -rounding:
            if alpha[i] >= 0.0:
                return np.nan
            smallest = max(smallest, beta[i] / alpha[i])
        if alpha[i] > beta[i] + rounding:
            if alpha[i] <= 0.0:
                return np.nan
            largest = min(largest, beta[i] / alpha[i])
    return smallest if smallest <= largest else np.nan


@compiled
def task_line(svd: Decomposition, scaled_twist: Array, max_entry: float) -> TaskLine:
    """The task line of a twist.

    Args:
        svd: Decomposition of the scaled Jacobian D J.
        scaled_twist: D V, (m,).
        max_entry: Largest absolute entry of V.
    """
    rank = svd.rank
    along = scaled_twist @ np.ascontiguousarray(svd.u[:, :rank])
    # Near a singularity the direction itself is not known more accurately.
    smallest = svd.sigma[rank - 1] if rank else 1.0
    rounding = min(max(BINDING, 4.0 * EPSILON * max_entry / smallest), MAX_BINDING)
    return TaskLine((along / svd.sigma[:rank]) @ svd.vt[:rank], svd.vt[rank:], rounding)


@compiled
def program_along(
    direction: Array, null: Array, base: Array, lo: Array, hi: Array, rows: Array, least: Array, rounding: float
) -> LinearProgram:
    """Box and dampers for qd = ``base`` + s ``direction`` + z' ``null``, as rows alpha s + zeta z <= beta."""
    n, d, k = len(base), len(null), len(least)
    alpha, zeta, beta = np.empty(2 * n + k), np.empty((2 * n + k, d)), np.empty(2 * n + k)
    for i in range(n):
        alpha[i], alpha[n + i] = direction[i], -direction[i]
        beta[i], beta[n + i] = hi[i] - base[i], base[i] - lo[i]
        for j in range(d):
            zeta[i, j], zeta[n + i, j] = null[j, i], -null[j, i]
    for r in range(k):
        alpha[2 * n + r], beta[2 * n + r] = -(rows[r] @ direction), rows[r] @ base - least[r]
        for j in range(d):
            zeta[2 * n + r, j] = -(rows[r] @ null[j])
    return LinearProgram(alpha, zeta, beta, rounding)


@compiled
def cost_along(null: Array, weight: Array, base: Array, direction: Array, pull: Array) -> NullSpaceCost:
    """The part of 1/2 qd' W qd + ``pull``' qd that depends on z, for qd = ``base`` + s ``direction`` + z' ``null``."""
    weighted = null @ weight if len(weight) else null
    return NullSpaceCost(weighted @ null.T, weighted @ base + null @ pull, weighted @ direction)


@compiled
def feasible_at_base(program: LinearProgram) -> LinearProgram:
    """The program with s = 0, z = 0 feasible in spite of rounding: the base point obeys all rows."""
    return LinearProgram(program.alpha, program.zeta, np.maximum(program.beta, 0.0), program.rounding)


@compiled
def unit_rows(rows: Array, least: Array) -> tuple[Array, Array]:
    """``rows`` qd >= ``least`` with rows of unit length, so that one tolerance fits all.

    A row that does not depend on any joint becomes a constraint that always holds.
    """
    units, limits = np.zeros(rows.shape), np.full(len(least), -1.0)
    for r in range(len(least)):
        size = np.sqrt(rows[r] @ rows[r])
        if size > ROUNDING:
            units[r], limits[r] = rows[r] / size, least[r] / size
    return units, limits

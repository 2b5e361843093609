"""The bounded problem of :mod:`ik_node.differential_ik.constrained` where the null space has one dimension or none: exact, compiled.

::

    qd = qd_0 + (s - s_0) p + Z' z ,        alpha s + zeta z <= beta ,  0 <= s <= 1

p is the velocity that gives the twist, Z a basis of the null space (rows). A six-joint arm has no z: the largest s is a
smallest ratio. A seven-joint arm has one: it drops out of every pair of rows, and what is left for it is an interval.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.pseudoinverse import EPSILON, Decomposition
from ik_node.math.types import Array

ROUNDING = 1e-12
"""Differences up to this one are rounding."""

BINDING = 1e-12
"""By how much a constraint may be exceeded before it counts as binding, rad/s (m/s); answers are clipped to it."""

MOST_BINDING = 1e-10
"""The same near singularities, where rounding is larger."""

DAMPER_BINDING = 1e-9
"""The same of a damper, whose row has unit length."""


class Program(NamedTuple):
    """The rows ``alpha`` s + ``zeta`` z <= ``beta``: (r,), (r, d), (r,)."""

    alpha: Array
    zeta: Array
    beta: Array
    rounding: float = ROUNDING
    """A row that s = 1 exceeds by no more than this does not limit s: s is not to hang on rounding."""


class Cost(NamedTuple):
    """1/2 z' ``hessian`` z + (``slope`` + s ``change``)' z; (d, d) positive definite, (d,), (d,)."""

    hessian: Array
    slope: Array
    change: Array


class Line(NamedTuple):
    """Where the answers lie."""

    ray: Array
    """p, (n,), rad/s (m/s)."""
    null: Array
    """Z, (d, n)."""
    rounding: float
    """How well p is known, rad/s (m/s)."""


class Found(NamedTuple):
    """An answer; ``scale`` is NaN where the box has no point on the line."""

    joint_velocity: Array
    """(n,), as computed: not yet clipped to the box."""
    scale: float
    base_velocity: Array
    base_scale: float
    fallback: bool
    """True where a solver failed, and the closed form was shortened instead."""


@compiled
def search(
    line: Line,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    base: Array,
    base_scale: float,
    weight: Array,
    pull: Array,
    free: Array,
) -> Found:
    """The optimum for one z or none.

    ``lo``, ``hi`` (n,): the box; ``rows`` (k, n) qd >= ``least`` (k,). ``base`` (n,) lies in both; ``base_scale`` is
    its s_0, or NaN where the point of the line that the box allows first is to be found. ``weight`` (n, n) or (0, 0),
    ``pull`` (n,): the cost 1/2 qd' W qd + pull' qd. ``free`` is for other searches, which may need it.
    """
    if np.isnan(base_scale):
        base_scale, z = entry(program_along(line.ray, line.null, np.zeros(len(lo)), lo, hi, rows, least, ROUNDING))
        if np.isnan(base_scale):
            return Found(free, np.nan, base, np.nan, False)
        base = np.minimum(np.maximum(base_scale * line.ray + z @ line.null, lo), hi)
    direction = (1.0 - base_scale) * line.ray
    program = at_the_base(program_along(direction, line.null, base, lo, hi, rows, least, line.rounding))
    part, z = best(program, cost_along(line.null, weight, base, direction, pull))
    qd = base + part * direction + z @ line.null
    return Found(qd, base_scale + part * (1.0 - base_scale), base, base_scale, False)


@compiled
def best(program: Program, cost: Cost) -> tuple[float, Array]:
    """The largest s, and the z of least ``cost`` for it: elimination (Fourier-Motzkin) gives s, an interval holds z."""
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
    """The largest s in [0, 1] with ``alpha`` s <= ``beta``, beta >= 0."""
    s = 1.0
    for i in range(len(alpha)):
        if alpha[i] > beta[i] + rounding:
            s = min(s, beta[i] / alpha[i])
    return s


@compiled
def _without_z(program: Program) -> tuple[Array, Array]:
    """What the rows say of s alone: those without the one z, and each pair of which z drops out.

    Row i, which bounds z from above, and row j, from below, each times the other's |zeta|. Rows without a finite limit
    say nothing.
    """
    alpha, zeta, beta = program.alpha, program.zeta[:, 0], program.beta
    most = len(beta) + len(beta) * len(beta) // 4
    found_alpha, found_beta, count = np.empty(most), np.empty(most), 0
    for i in range(len(beta)):
        if zeta[i] > ROUNDING:
            for j in range(len(beta)):
                if zeta[j] < -ROUNDING:
                    size = zeta[i] - zeta[j]
                    found_alpha[count] = (zeta[i] * alpha[j] - zeta[j] * alpha[i]) / size
                    found_beta[count] = (zeta[i] * beta[j] - zeta[j] * beta[i]) / size
                    count += 1
        elif zeta[i] >= -ROUNDING:
            found_alpha[count], found_beta[count] = alpha[i], beta[i]
            count += 1
    return found_alpha[:count], found_beta[:count]


@compiled
def _interval(program: Program, s: float) -> tuple[float, float]:
    """Where the one z may be at this s."""
    lowest, highest = -np.inf, np.inf
    for i in range(len(program.beta)):
        zeta, room = program.zeta[i, 0], program.beta[i] - program.alpha[i] * s
        if zeta > ROUNDING:
            highest = min(highest, room / zeta)
        elif zeta < -ROUNDING:
            lowest = max(lowest, room / zeta)
    return lowest, highest


@compiled
def entry(program: Program) -> tuple[float, Array]:
    """The least s in [0, 1] that the rows allow with some z, and such a z; NaN where there is none.

    Here ``beta`` may be negative: s = 0, z = 0 need not be allowed.
    """
    if program.zeta.shape[1] == 0:
        return _least(program.alpha, program.beta, program.rounding), np.zeros(0)
    alpha, beta = _without_z(program)
    s = _least(alpha, beta, program.rounding)
    lowest, highest = _interval(program, s)
    middle = 0.5 * (lowest + highest)
    return s, np.array([middle if np.isfinite(middle) else 0.0])


@compiled
def _least(alpha: Array, beta: Array, rounding: float) -> float:
    """The least s in [0, 1] with ``alpha`` s <= ``beta``; NaN where there is none."""
    least, largest = 0.0, 1.0
    for i in range(len(alpha)):
        if beta[i] < -rounding:
            if alpha[i] >= 0.0:
                return np.nan
            least = max(least, beta[i] / alpha[i])
        if alpha[i] > beta[i] + rounding:
            if alpha[i] <= 0.0:
                return np.nan
            largest = min(largest, beta[i] / alpha[i])
    return least if least <= largest else np.nan


@compiled
def line_of(parts: Decomposition, scaled_twist: Array, fastest: float) -> Line:
    """The line of a twist whose largest entry is ``fastest``; its rows, and those of J, are scaled."""
    rank = parts.rank
    along = scaled_twist @ np.ascontiguousarray(parts.u[:, :rank])
    # Near a singularity the direction itself is known no better than this.
    smallest = parts.sigma[rank - 1] if rank else 1.0
    rounding = min(max(BINDING, 4.0 * EPSILON * fastest / smallest), MOST_BINDING)
    return Line((along / parts.sigma[:rank]) @ parts.vt[:rank], parts.vt[rank:], rounding)


@compiled
def program_along(
    direction: Array, null: Array, base: Array, lo: Array, hi: Array, rows: Array, least: Array, rounding: float
) -> Program:
    """Box and dampers for qd = ``base`` + s ``direction`` + z' ``null``, as  alpha s + zeta z <= beta ."""
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
    return Program(alpha, zeta, beta, rounding)


@compiled
def cost_along(null: Array, weight: Array, base: Array, direction: Array, pull: Array) -> Cost:
    """1/2 qd' W qd + ``pull``' qd for qd = ``base`` + s ``direction`` + z' ``null``, as far as it hangs on z."""
    weighted = null @ weight if len(weight) else null
    return Cost(weighted @ null.T, weighted @ base + null @ pull, weighted @ direction)


@compiled
def at_the_base(program: Program) -> Program:
    """At the base point (no further along the line, z = 0) all rows hold, whatever rounding says."""
    return Program(program.alpha, program.zeta, np.maximum(program.beta, 0.0), program.rounding)


@compiled
def unit_rows(rows: Array, least: Array) -> tuple[Array, Array]:
    """``rows`` qd >= ``least`` with rows of unit length, so that one tolerance serves all.

    A row that no joint moves says nothing any more.
    """
    units, limits = np.zeros(rows.shape), np.full(len(least), -1.0)
    for r in range(len(least)):
        size = np.sqrt(rows[r] @ rows[r])
        if size > ROUNDING:
            units[r], limits[r] = rows[r] / size, least[r] / size
    return units, limits

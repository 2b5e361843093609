"""Linear and quadratic programs of a few variables: maximise s, then minimise a cost at that s.

::

    alpha s + zeta z <= beta ,  0 <= s <= 1 ,  beta >= 0        so that s = 0, z = 0 is always allowed

z has as many entries as the null space of the task has dimensions: none for a six-joint arm, one for a seven-joint arm.
Those two are solved exactly, without a solver. The others go to DAQP, and its answers are checked.
"""

from __future__ import annotations

import daqp
import numpy as np

from ik_node.differential_ik.exact_program import ROUNDING, Cost, Program
from ik_node.math.types import Array

ACCEPTED = 1e-10
"""Largest trespass of a solver's answer that is put right by clipping; beyond, the answer is not used."""

UNLIMITED = 1e30
"""DAQP's infinity."""

STILL = 1e-12
"""Steps and multipliers up to this one are rounding."""

MOST_STEPS = 100
"""Of the active-set method: ten times what was seen."""


def best(program: Program, cost: Cost) -> tuple[float, Array] | None:
    """The largest s, and the z of least ``cost`` for it; None where no answer passed its check.

    DAQP's linear programs end within 1e-6 of the optimum, at points that obey the rows to 1e-10;
    the active-set method goes on from there to the vertex, and then to the least cost."""
    dimensions = program.zeta.shape[1]
    limited = np.isfinite(program.beta)
    alpha, zeta, beta = program.alpha[limited], program.zeta[limited], program.beta[limited]
    whole = _full_scale(alpha, zeta, beta, cost)
    if whole is not None:
        return 1.0, whole
    goal = np.zeros(1 + dimensions)
    goal[0] = -1.0
    upper = np.concatenate(([1.0], np.full(dimensions, UNLIMITED), beta))
    lower = np.concatenate(([0.0], np.full(dimensions + len(beta), -UNLIMITED)))
    matrix = np.column_stack((alpha, zeta))
    start, _, flag, _ = daqp.solve(None, goal, matrix, upper, lower, primal_tol=1e-10)
    if flag != 1 or not _fits(matrix @ start, beta):
        start = np.zeros(1 + dimensions)
    ends = np.zeros((2, 1 + dimensions))
    ends[:, 0] = 1.0, -1.0
    best = descend(None, goal, np.concatenate((ends, matrix)), np.concatenate(([1.0, 0.0], beta)), start)
    if best is None:
        return None
    s = min(max(float(best[0]), 0.0), 1.0)
    z = descend(cost.hessian, cost.slope + s * cost.change, zeta, beta - s * alpha, best[1:])
    return s, best[1:] if z is None else z


def _full_scale(alpha: Array, zeta: Array, beta: Array, cost: Cost) -> Array | None:
    """The z of least cost at s = 1, the usual case; None where s has to be less."""
    room = beta - alpha
    unlimited = np.full(len(room), -UNLIMITED)
    hessian, rows = np.ascontiguousarray(cost.hessian), np.ascontiguousarray(zeta)
    z, _, flag, _ = daqp.solve(hessian, cost.slope + cost.change, rows, room, unlimited, primal_tol=1e-11)
    return np.asarray(z) if flag == 1 and _fits(zeta @ z, room) else None


def _fits(values: Array, limits: Array) -> bool:
    return bool(np.isfinite(values).all() and (values <= limits + ACCEPTED).all())


def descend(hessian: Array | None, slope: Array, rows: Array, limits: Array, start: Array) -> Array | None:
    """The least 1/2 x' H x + ``slope``' x with ``rows`` x <= ``limits``, by a primal active-set method.

    ``hessian`` (d, d) positive definite, or None: a linear program, which the rows must bound. ``start`` obeys the
    rows; small trespasses are not undone, but not enlarged. Nocedal and Wright, Numerical Optimization, algorithm 16.3.
    None where it did not end.
    """
    x, working = start.copy(), list[int]()
    for count in range(MOST_STEPS):
        slope_here = slope if hessian is None else slope + hessian @ x
        active = rows[working]
        free = _null_space(active, len(x))
        step = _step(hessian, slope_here, free)
        if np.abs(step).max(initial=0.0) <= STILL * max(1.0, np.abs(x).max()):
            multipliers = np.linalg.lstsq(active.T, -slope_here, rcond=None)[0] if working else np.zeros(0)
            wrong = np.flatnonzero(multipliers < -STILL)
            if len(wrong) == 0:
                return np.asarray(x)
            # The most negative one; the first one (Bland's rule) once there is a suspicion of going in circles.
            working.pop(int(wrong[0]) if count > MOST_STEPS // 2 else int(np.argmin(multipliers)))
            continue
        towards = rows @ step
        towards[working] = 0.0
        ahead = towards > STILL * max(1.0, np.abs(step).max())
        if not ahead.any():
            if hessian is None:
                return None
            x = x + step
            continue
        reach = np.full(len(limits), np.inf)
        reach[ahead] = np.maximum(limits[ahead] - rows[ahead] @ x, 0.0) / towards[ahead]
        nearest = float(reach.min())
        if hessian is not None and nearest >= 1.0:
            x = x + step
            continue
        x = x + nearest * step
        tied = np.flatnonzero(reach <= nearest)
        working.append(int(tied[np.argmax(towards[tied])]))
    return None


def _null_space(active: Array, size: int) -> Array:
    """A basis, as columns, of the steps that leave the active rows as they are."""
    if len(active) == 0:
        return np.eye(size)
    q, _ = np.linalg.qr(active.T, mode="complete")
    return np.asarray(q[:, len(active) :])


def _step(hessian: Array | None, slope: Array, free: Array) -> Array:
    """To the minimum on the active rows, or straight downhill where there is no curvature."""
    if free.shape[1] == 0:
        return np.zeros(len(slope))
    downhill = free.T @ slope
    if hessian is not None:
        downhill = np.linalg.solve(free.T @ hessian @ free, downhill)
    return np.asarray(-(free @ downhill))


def entry(program: Program) -> tuple[float, Array] | None:
    """The least s in [0, 1] that the rows allow with some z, and such a z; None where there is none.

    Here ``beta`` may be negative: s = 0, z = 0 need not be allowed.
    """
    dimensions = program.zeta.shape[1]
    limited = np.isfinite(program.beta)
    beta = program.beta[limited]
    goal = np.zeros(1 + dimensions)
    goal[0] = 1.0
    upper = np.concatenate(([1.0], np.full(dimensions, UNLIMITED), beta))
    lower = np.concatenate(([0.0], np.full(dimensions + len(beta), -UNLIMITED)))
    matrix = np.column_stack((program.alpha[limited], program.zeta[limited]))
    found, _, flag, _ = daqp.solve(None, goal, matrix, upper, lower, primal_tol=1e-10)
    if flag != 1 or not _fits(matrix @ found, beta):
        return None
    return min(max(float(found[0]), 0.0), 1.0), np.asarray(found[1:])


def nearest_to_ray(
    jacobian: Array, twist: Array, lo: Array, hi: Array, rows: Array, least: Array, otherwise: Array
) -> tuple[Array, float]:
    """The qd in the box, with ``rows`` qd >= ``least``, and the t in [0, 1] of least \\|J qd - t V\\|.

    Among equals nearly the one nearest to rest. Where the solver fails: ``otherwise`` and 0.
    """
    n = len(lo)
    miss = np.column_stack((jacobian, -twist))
    hessian = miss.T @ miss
    # What is left open is drawn to rest, by so little that the direction does not suffer.
    hessian[np.diag_indices(n + 1)] += 1e-11 * (1.0 + np.trace(hessian))
    upper = np.concatenate((np.minimum(hi, UNLIMITED), [1.0], np.full(len(least), UNLIMITED)))
    lower = np.concatenate((np.maximum(lo, -UNLIMITED), [0.0], least))
    matrix = np.column_stack((rows, np.zeros(len(least))))
    found, _, flag, _ = daqp.solve(hessian, np.zeros(n + 1), matrix, upper, lower, primal_tol=1e-10)
    if flag != 1 or not np.isfinite(found).all():
        return otherwise, 0.0
    return np.minimum(np.maximum(found[:n], lo), hi), min(max(float(found[n]), 0.0), 1.0)


def nearest_to_twist(jacobian: Array, twist: Array, lo: Array, hi: Array, rows: Array, least: Array) -> Array | None:
    """The qd in the box, with ``rows`` qd >= ``least``, of least \\|J qd - V\\|, whatever its direction; None if none.

    Damped by a thousandth of the largest singular value, so that it stays gentle where J is nearly singular.
    """
    hessian = jacobian.T @ jacobian
    hessian[np.diag_indices(len(lo))] += 1e-3 * np.trace(hessian) / len(lo)
    upper = np.concatenate((np.minimum(hi, UNLIMITED), np.full(len(least), UNLIMITED)))
    lower = np.concatenate((np.maximum(lo, -UNLIMITED), least))
    slope = -(jacobian.T @ twist)
    found, _, flag, _ = daqp.solve(hessian, slope, np.ascontiguousarray(rows), upper, lower, primal_tol=1e-10)
    if flag != 1 or not np.isfinite(found).all():
        return None
    return np.asarray(np.minimum(np.maximum(found, lo), hi))


def nearest_to_rest(clipped: Array, lo: Array, hi: Array, rows: Array, least: Array) -> tuple[Array, Array]:
    """The least ||qd|| with lo <= qd <= hi and ``rows`` qd >= ``least``, and by how much each row had to give way.

    ``clipped`` (n,) is the answer without the rows, and the answer where it obeys them. Where the box leaves no room,
    all rows give way by the same, least amount. Where the solver fails, rows give way to ``clipped``.
    """
    slack = np.zeros(len(least))
    if (rows @ clipped >= least - ROUNDING).all():
        return clipped, slack
    n = len(clipped)
    high, low = np.minimum(hi, UNLIMITED), np.maximum(lo, -UNLIMITED)
    needed = _least_slack(rows, least, low, high)
    if needed > 0.0:
        slack = np.full(len(least), needed)
    # A hair of room, without which a set that is a single point cannot be found.
    hair = 1e-10 if needed > 0.0 else 0.0
    upper = np.concatenate((high, np.full(len(least), UNLIMITED)))
    lower = np.concatenate((low, least - slack - hair))
    answer, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), np.ascontiguousarray(rows), upper, lower, primal_tol=1e-10)
    if flag != 1 or not np.isfinite(answer).all():
        return clipped, np.maximum(least - rows @ clipped, 0.0)
    base = np.minimum(np.maximum(answer, lo), hi)
    return base, np.maximum(least - rows @ base, 0.0)


def _least_slack(rows: Array, least: Array, low: Array, high: Array) -> float:
    """The smallest t >= 0 with ``rows`` qd + t >= ``least`` for some qd in the box."""
    n, count = rows.shape[1], len(least)
    matrix = np.column_stack((rows, np.ones(count)))
    goal = np.zeros(n + 1)
    goal[n] = 1.0
    upper = np.concatenate((high, [UNLIMITED], np.full(count, UNLIMITED)))
    lower = np.concatenate((low, [0.0], least))
    answer, _, flag, _ = daqp.solve(None, goal, matrix, upper, lower, primal_tol=1e-10)
    if flag != 1 or not np.isfinite(answer).all():
        return float(np.max(least + np.maximum(np.abs(rows) @ np.maximum(np.abs(low), np.abs(high)), 0.0)))
    return float(answer[n]) if answer[n] > ROUNDING else 0.0

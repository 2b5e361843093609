"""Linear and quadratic programs solved by DAQP, whose answers are checked here.

DAQP is a dual active-set solver (Arnstroem, Bemporad, Axehill, "A Dual Active-Set Solver for Embedded Quadratic
Programming Using Recursive LDL' Updates", IEEE TAC 2022). It serves the null spaces of two and more dimensions, and
the points from which :mod:`ik_node.differential_ik.constrained` starts::

    maximise s, then minimise a cost over z at that s
    subject to  alpha s + zeta z <= beta ,  0 <= s <= 1 ,  beta >= 0        (s = 0, z = 0 is feasible)

On 2500 random programs with null spaces of 2 to 6 dimensions s is within 3e-7 of HiGHS, the cost within 2e-9, and the
optimality conditions hold to 2e-11. The active rows of an answer are then solved by linear algebra, so that it is
accurate to rounding, and inputs that differ by rounding have the same answer. A primal tolerance of 1e-12 makes one
program in a hundred fail; 1e-6 violates rows by as much.
"""

from __future__ import annotations

import daqp
import numpy as np

from ik_node.differential_ik.bounded_least_squares import bounded_least_squares
from ik_node.differential_ik.exact_program import ROUNDING, LinearProgram, NullSpaceCost
from ik_node.math.types import Array

PRIMAL_TOLERANCE = 1e-10
"""Feasibility tolerance of the solver."""

MAX_VIOLATION = 1e-10
"""Largest violation of a row that is corrected by clipping; with a larger one the answer is not used."""

WIDENINGS = (0.0, 1e-12, 1e-11, 5e-11)
"""By how much rows are widened, one after the other, where the solver finds no z at the largest s: there the feasible
set is often a single point. Without this one answer in 2500 is not of least cost."""

MAX_CORRECTION = 1e-6
"""Largest difference between an answer and the solution of its active rows, relative to 1 + the answer; beyond it those
rows are not the active ones."""

UNLIMITED = 1e30
"""Infinity for DAQP."""

REGULARISATION = 1e-7
"""Weight of the joint velocities beside the deviation from a ray."""

WEIGHT = 1e4
"""Factor of a cost whose differences would otherwise be below the solver's tolerance."""

SOLVED = 1
"""DAQP's exit flag of an optimal solution."""


def largest_scale(program: LinearProgram, cost: NullSpaceCost) -> tuple[float, Array] | None:
    """The largest s, and the z of least ``cost`` at that s; None if no answer passed its check."""
    dimensions = program.zeta.shape[1]
    limited = np.isfinite(program.beta)
    alpha, zeta, beta = program.alpha[limited], program.zeta[limited], program.beta[limited]
    z = _least_cost(cost, 1.0, alpha, zeta, beta, 1e-11)
    if z is not None:  # the usual case
        return 1.0, z
    goal = np.zeros(1 + dimensions)
    goal[0] = -1.0
    vertex = _optimal_vertex(goal, alpha, zeta, beta)
    if vertex is None:
        return None
    s = min(max(float(vertex[0]), 0.0), 1.0)
    for widening in WIDENINGS:
        z = _least_cost(cost, s, alpha, zeta, beta, PRIMAL_TOLERANCE, widening)
        if z is not None and _obeys(zeta @ z, beta - s * alpha):
            return s, z
    return s, vertex[1:]


def smallest_scale(program: LinearProgram) -> tuple[float, Array] | None:
    """The smallest s in [0, 1] that is feasible with some z, and such a z; None if there is none.

    Here ``beta`` may be negative: s = 0, z = 0 may be infeasible.
    """
    limited = np.isfinite(program.beta)
    goal = np.zeros(1 + program.zeta.shape[1])
    goal[0] = 1.0
    vertex = _optimal_vertex(goal, program.alpha[limited], program.zeta[limited], program.beta[limited])
    return None if vertex is None else (min(max(float(vertex[0]), 0.0), 1.0), vertex[1:])


def _optimal_vertex(goal: Array, alpha: Array, zeta: Array, beta: Array) -> Array | None:
    r"""The (s, z) of least ``goal``' (s, z) with alpha s + zeta z <= beta and s in [0, 1].

    The unknown is s times the largest \|alpha\|: with the column of a small twist the solver finds no solution.
    """
    dimensions = zeta.shape[1]
    size = float(np.abs(alpha).max(initial=0.0)) or 1.0
    upper = np.concatenate(([size], np.full(dimensions, UNLIMITED), beta))
    lower = np.concatenate(([0.0], np.full(dimensions + len(beta), -UNLIMITED)))
    matrix = np.column_stack((alpha / size, zeta))
    vertex, _, flag, found = daqp.solve(None, goal, matrix, upper, lower, primal_tol=PRIMAL_TOLERANCE)
    if flag != SOLVED or not _obeys(matrix @ vertex, beta):
        return None
    active = np.flatnonzero(np.asarray(found["lam"])[1 + dimensions :])
    s = _scale_of_rows(alpha[active], zeta[active], beta[active])
    close = abs(s * size - vertex[0]) < MAX_CORRECTION * (1.0 + abs(vertex[0]))
    return np.append(s if close else vertex[0] / size, vertex[1:])


def _scale_of_rows(alpha: Array, zeta: Array, beta: Array) -> float:
    """The s of least or largest value that active rows permit with some z; NaN if they do not determine it.

    The multipliers of the rows cancel z: lambda' zeta = 0, and lambda' (alpha s - beta) = 0 remains.
    """
    if not len(beta):
        return float("nan")
    conditions = np.vstack((zeta.T, alpha))
    wanted = np.append(np.zeros(zeta.shape[1]), 1.0)
    multipliers = np.linalg.lstsq(conditions, wanted, rcond=1e-10)[0]
    cancels = float(np.abs(conditions @ multipliers - wanted).max()) < 1e-9
    return float(multipliers @ beta) if cancels else float("nan")


def _least_cost(
    cost: NullSpaceCost, s: float, alpha: Array, zeta: Array, beta: Array, tolerance: float, widening: float = 0.0
) -> Array | None:
    """The z of least ``cost`` at ``s``; the solver may exceed rows by ``widening``."""
    limits = beta - s * alpha
    hessian, rows = np.ascontiguousarray(cost.hessian), np.ascontiguousarray(zeta)
    unlimited = np.full(len(limits), -UNLIMITED)
    slope = cost.slope + s * cost.change
    z, _, flag, found = daqp.solve(hessian, slope, rows, limits + widening, unlimited, primal_tol=tolerance)
    if flag != SOLVED or not _obeys(zeta @ z, limits + widening):
        return None
    active = np.flatnonzero(found["lam"])
    count, dimensions = len(active), len(slope)
    conditions = np.zeros((dimensions + count, dimensions + count))
    conditions[:dimensions, :dimensions] = hessian
    conditions[dimensions:, :dimensions] = zeta[active]
    conditions[:dimensions, dimensions:] = zeta[active].T
    exact = np.linalg.lstsq(conditions, np.append(-slope, limits[active]), rcond=1e-12)[0][:dimensions]
    close = float(np.abs(exact - z).max(initial=0.0)) < MAX_CORRECTION * (1.0 + float(np.abs(z).max(initial=0.0)))
    return np.asarray(exact if close and _obeys(zeta @ exact, limits) else z, dtype=np.float64)


def _obeys(values: Array, limits: Array) -> bool:
    return bool(np.isfinite(values).all() and (values <= limits + MAX_VIOLATION).all())


def nearest_to_ray(
    jacobian: Array, twist: Array, lo: Array, hi: Array, rows: Array, least: Array, start: Array
) -> tuple[Array, float]:
    """The qd and the t in [0, 1] of least \\|J qd - t V\\| with lo <= qd <= hi and ``rows`` qd >= ``least``.

    Among several minima nearly the one of least \\|qd\\|. ``start`` (n,) is inside; it is returned with 0 if the solver
    fails.
    """
    n, speed = len(lo), float(np.sqrt(twist @ twist))
    # The last unknown is t times |V|, so that the columns are of similar size.
    ray = twist / speed if speed > 0.0 else twist
    deviation = np.column_stack((jacobian, -ray))
    bounds_lo, bounds_hi = np.append(lo, 0.0), np.append(hi, speed)
    # A small regularisation towards zero velocity, which does not change the direction noticeably.
    damped = np.concatenate((deviation, REGULARISATION * np.eye(n + 1)))
    first = np.append(start, 0.0)
    if len(least) == 0:
        point = bounded_least_squares(damped, np.zeros(len(damped)), bounds_lo, bounds_hi, first)
    else:
        upper = np.concatenate((np.minimum(bounds_hi, UNLIMITED), np.full(len(least), UNLIMITED)))
        lower = np.concatenate((np.maximum(bounds_lo, -UNLIMITED), least))
        matrix = np.column_stack((rows, np.zeros(len(least))))
        hessian = WEIGHT * (deviation.T @ deviation + 1e-10 * np.eye(n + 1))
        point, _, flag, _ = daqp.solve(hessian, np.zeros(n + 1), matrix, upper, lower, primal_tol=PRIMAL_TOLERANCE)
        if flag != SOLVED:
            return start, 0.0
    if not np.isfinite(point).all():
        return start, 0.0
    t = float(point[n]) / speed if speed > 0.0 else 0.0
    return np.minimum(np.maximum(point[:n], lo), hi), min(max(t, 0.0), 1.0)


def least_motion(
    jacobian: Array, twist: Array, lo: Array, hi: Array, rows: Array, least: Array, point: tuple[Array, float]
) -> tuple[Array, float]:
    """The qd and t of least \\|qd\\|^2 + (t \\|V\\|)^2 among those with the deviation J qd - t V of a ``point`` inside.

    :func:`nearest_to_ray` determines the deviation, but of many qd with that deviation it returns any.
    """
    n, speed = len(lo), float(np.sqrt(twist @ twist))
    if speed == 0.0:
        return point
    start = np.append(point[0], speed * point[1])
    _, sizes, axes = np.linalg.svd(np.column_stack((jacobian, -twist / speed)))
    free = axes[int((sizes > ROUNDING * sizes[0]).sum()) :].T
    matrix = np.vstack((np.eye(n + 1), -np.eye(n + 1), -np.column_stack((rows, np.zeros(len(least))))))
    limits = np.concatenate((hi, [speed], -lo, [0.0], -least))
    limited = np.isfinite(limits)
    zeta, beta = matrix[limited] @ free, np.maximum(limits[limited] - matrix[limited] @ start, 0.0)
    cost = NullSpaceCost(np.eye(free.shape[1]), free.T @ start, np.zeros(free.shape[1]))
    z = _least_cost(cost, 0.0, np.zeros(len(beta)), zeta, beta, PRIMAL_TOLERANCE)
    if z is None:
        return point
    moved = start + free @ z
    return np.minimum(np.maximum(moved[:n], lo), hi), min(max(float(moved[n]) / speed, 0.0), 1.0)


def nearest_to_twist(
    jacobian: Array, twist: Array, lo: Array, hi: Array, rows: Array, least: Array, damping: float
) -> Array | None:
    """The qd of least \\|J qd - V\\|^2 + ``damping`` \\|qd\\|^2 within lo <= qd <= hi and ``rows`` qd >= ``least``.

    Returns:
        (n,); None if the solver finds none.
    """
    hessian = jacobian.T @ jacobian
    hessian[np.diag_indices(len(lo))] += damping
    upper = np.concatenate((np.minimum(hi, UNLIMITED), np.full(len(least), UNLIMITED)))
    lower = np.concatenate((np.maximum(lo, -UNLIMITED), least))
    slope = -(jacobian.T @ twist)
    matrix = np.ascontiguousarray(rows)
    qd, _, flag, _ = daqp.solve(hessian, slope, matrix, upper, lower, primal_tol=PRIMAL_TOLERANCE)
    if flag != SOLVED or not np.isfinite(qd).all():
        return None
    return np.asarray(np.minimum(np.maximum(qd, lo), hi))


def nearest_to_rest(clipped: Array, lo: Array, hi: Array, rows: Array, least: Array) -> tuple[Array, Array]:
    """The qd of least \\|qd\\| with lo <= qd <= hi and ``rows`` qd >= ``least``, and the slack of each row.

    If the box leaves no room for the rows, all of them are relaxed by the same, least amount. If the solver fails, the
    rows are relaxed to ``clipped``.

    Args:
        clipped: The solution without the rows, (n,); it is returned if it obeys them.
        lo: Lower ends of the box, (n,).
        hi: Upper ends of the box, (n,).
        rows: (k, n).
        least: (k,).
    """
    slack = np.zeros(len(least))
    if (rows @ clipped >= least - ROUNDING).all():
        return clipped, slack
    n = len(clipped)
    high, low = np.minimum(hi, UNLIMITED), np.maximum(lo, -UNLIMITED)
    needed = _least_slack(rows, least, low, high)
    if needed > 0.0:
        slack = np.full(len(least), needed)
    # The solver cannot find a feasible set that is a single point; this widens it.
    widening = 1e-10 if needed > 0.0 else 0.0
    upper = np.concatenate((high, np.full(len(least), UNLIMITED)))
    lower = np.concatenate((low, least - slack - widening))
    matrix = np.ascontiguousarray(rows)
    qd, _, flag, _ = daqp.solve(np.eye(n), np.zeros(n), matrix, upper, lower, primal_tol=PRIMAL_TOLERANCE)
    if flag != SOLVED or not np.isfinite(qd).all():
        return clipped, np.maximum(least - rows @ clipped, 0.0)
    base = np.minimum(np.maximum(qd, lo), hi)
    return base, np.maximum(least - rows @ base, 0.0)


def _least_slack(rows: Array, least: Array, low: Array, high: Array) -> float:
    """The smallest t >= 0 with ``rows`` qd + t >= ``least`` for some qd in the box."""
    n, count = rows.shape[1], len(least)
    matrix = np.column_stack((rows, np.ones(count)))
    goal = np.zeros(n + 1)
    goal[n] = 1.0
    upper = np.concatenate((high, [UNLIMITED], np.full(count, UNLIMITED)))
    lower = np.concatenate((low, [0.0], least))
    point, _, flag, _ = daqp.solve(None, goal, matrix, upper, lower, primal_tol=PRIMAL_TOLERANCE)
    if flag != SOLVED or not np.isfinite(point).all():
        return float(np.max(least + np.maximum(np.abs(rows) @ np.maximum(np.abs(low), np.abs(high)), 0.0)))
    return float(point[n]) if point[n] > ROUNDING else 0.0

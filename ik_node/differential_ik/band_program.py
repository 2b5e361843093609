r"""The optimum of a control step with bands where the whole twist is executed, although a border or a limit binds.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J_t qd = V_t ,   r_i qd >= v_i        bands, velocity dampers, and both ends of the box

With qd_0 the closed form without inequalities, N a basis of the null space of J_t (rows) and N W N' = L L', the
optimum is qd_0 + N' L'^-1 y with the y of least \|y\| that obeys the inequalities, which are few; it is found by the
dual active set method of D. Goldfarb and A. Idnani ("A numerically stable dual method for solving strictly convex
quadratic programs", Mathematical Programming 27, 1983).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.exact_program import ROUNDING
from ik_node.jit import compiled
from ik_node.math.pseudoinverse import Decomposition
from ik_node.math.types import Array

MAX_CHANGES = 40
"""Rows that are added; random problems need three at most."""
MIN_INDEPENDENCE = 1e-5
"""Part of a row, of length 1 or less, that has to be independent of the active rows."""
MAX_VIOLATION = 1e-11
"""Largest violation of an active row by rounding, m/s or rad/s."""


@compiled
def velocity_with_bands(
    svd: Decomposition,
    free: Array,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    band_rows: Array,
    band_least: Array,
    weight: Array,
) -> tuple[bool, Array]:
    """The optimum at s = 1.

    Args:
        svd: Decomposition of J_t with scaled rows.
        free: The closed form, (n,).
        lo: Lower ends of the box, (n,), rad/s (m/s).
        hi: Upper ends, (n,).
        rows: Velocity dampers ``rows`` qd >= ``least``, (k, n).
        least: (k,).
        band_rows: Rows of the bands, (b, n).
        band_least: v, (b,).
        weight: W, (n, n), or :data:`ik_node.differential_ik.closed_form.IDENTITY`.

    Returns:
        Whether there is one, and qd, (n,).
    """
    unit, end = _inequalities(band_rows, band_least, rows, least, lo, hi)
    null = np.ascontiguousarray(svd.vt[svd.rank :])
    map_to_z = np.eye(len(null))
    if len(weight) and len(null):
        map_to_z = np.ascontiguousarray(np.linalg.inv(np.linalg.cholesky(null @ weight @ null.T)))
    move = map_to_z @ null
    found, y = nearest_point(np.ascontiguousarray(unit @ move.T), end - unit @ free)
    velocity = np.minimum(np.maximum(free + y @ move, lo), hi)
    return found and bool(np.all(np.isfinite(velocity))), velocity


@compiled
def nearest_point(rows: Array, least: Array) -> tuple[bool, Array]:
    r"""The y (d,) of least \|y\| with ``rows`` y >= ``least``, rows of length 1 or less.

    Args:
        rows: (k, d).
        least: (k,).

    Returns:
        Whether it was found, and y.
    """
    k, d = rows.shape
    y, multipliers, active, count = np.zeros(d), np.zeros(d), np.zeros(d, dtype=np.int64), 0
    is_active = np.zeros(k, dtype=np.bool_)
    for _ in range(MAX_CHANGES):
        new = _most_violated(rows, least, y, is_active)
        if new < 0:
            exact = np.abs(rows[active[:count]] @ y - least[active[:count]])
            return bool(np.all(exact <= MAX_VIOLATION)), y
        multiplier = 0.0
        while not is_active[new]:
            step, change = rows[new].copy(), np.zeros(count)
            if count:
                held = rows[active[:count]]
                change = np.linalg.solve(held @ held.T, held @ step)
                step = step - change @ held
            size, whole, part, blocking = step @ step, np.inf, np.inf, -1
            if count < d and size > MIN_INDEPENDENCE * MIN_INDEPENDENCE:
                whole = (least[new] - rows[new] @ y) / size
            for i in range(count):
                if change[i] > 0.0 and max(multipliers[i], 0.0) < part * change[i]:
                    part, blocking = max(multipliers[i], 0.0) / change[i], i
            length = min(whole, part)
            if not np.isfinite(length):
                return False, y
            if np.isfinite(whole):
                y = y + length * step
            multiplier += length
            multipliers[:count] -= length * change
            if whole <= part:
                active[count], multipliers[count], is_active[new] = new, multiplier, True
                count += 1
            else:
                is_active[active[blocking]] = False
                active[blocking : count - 1] = active[blocking + 1 : count].copy()
                multipliers[blocking : count - 1] = multipliers[blocking + 1 : count].copy()
                count -= 1
    return False, y


@compiled
def _most_violated(rows: Array, least: Array, y: Array, is_active: NDArray[np.bool_]) -> int:
    """Index of the row that y violates most; -1 for none."""
    worst, most = -1, ROUNDING
    for i in range(len(least)):
        if not is_active[i] and not rows[i] @ y >= least[i] - most:
            worst, most = i, least[i] - rows[i] @ y
    return worst


@compiled
def _inequalities(
    band_rows: Array, band_least: Array, rows: Array, least: Array, lo: Array, hi: Array
) -> tuple[Array, Array]:
    """Bands, dampers, lower and upper ends of the box as rows of unit length; rows without length always hold."""
    b, k, n = len(band_least), len(least), len(lo)
    unit, end = np.zeros((b + k + 2 * n, n)), np.full(b + k + 2 * n, -1.0)
    for i in range(b + k):
        row, value = (band_rows[i], band_least[i]) if i < b else (rows[i - b], least[i - b])
        size = np.sqrt(row @ row)
        if size > ROUNDING:
            unit[i], end[i] = row / size, value / size
    for j in range(n):
        unit[b + k + j, j], end[b + k + j] = 1.0, lo[j]
        unit[b + k + n + j, j], end[b + k + n + j] = -1.0, -hi[j]
    return unit, end

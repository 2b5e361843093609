r"""The optimum of a control step under limits by an active set: any null space, with or without bands; compiled.

::

    minimise    1/2 qd' W qd + k grad_h' qd
    subject to  J_t qd = s V_t ,   r_i qd >= s v_i      s in [0, s_wish] as large as possible
                N qd >= c ,  lo <= qd <= hi             velocity dampers, both ends of the box

With qd_0(s) the closed form for s V_t, N a basis of the null space of J_t (rows) and N W N' = L L', the optimum at one
s is qd_0 + N' L'^-1 y with the y of least \|y\| that obeys the inequalities, which are few; it is found by the dual
active set method of D. Goldfarb and A. Idnani ("A numerically stable dual method for solving strictly convex quadratic
programs", Mathematical Programming 27, 1983). Where there is none, the method ends with multipliers lambda >= 0 of rows
whose sum does not depend on y: their limits permit at most the s at which the sum of these limits is zero. With this s
it begins again, from s_wish on; every such s is a bound, so that the first s with an optimum is the largest one.
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
MIN_INDEPENDENCE = 1e-9
"""Part of a row, of length 1 or less, that has to be independent of the active rows."""
MIN_SLOPE = 1e-5
"""Part of a row of unit length in the null space from which it depends on y.

Angles of URDFs that are rounded to six digits give parts of 5e-7 to joints that do not move in exact null spaces: an s
that is larger by as much would take null-space velocities that turn with rounding. s is lowered by so much instead.
"""
ROW_NOISE = 1e-10
"""Rounding of rows, above that of a basis of the null space: an independent part may be that of the active rows."""
MAX_SCALES = 40
"""Largest number of s that are tried; random problems need four at most."""
SCALE_STEP = 1e-11
"""Least relative decrease of s: beside the largest s rounding may permit none."""
MAX_VIOLATION = 1e-11
"""Largest violation of an active row by rounding, m/s or rad/s."""


@compiled
def largest_motion(
    svd: Decomposition,
    ray: Array,
    free: Array,
    wish: float,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    band_rows: Array,
    band_least: Array,
    weight: Array,
) -> tuple[float, Array]:
    """The optimum with the largest s up to ``wish``.

    Args:
        svd: Decomposition of J_t with scaled rows.
        ray: A joint velocity that gives V_t, (n,), rad/s (m/s).
        free: The closed form for ``wish`` V_t, (n,).
        wish: s_wish, 0 to 1.
        lo: Lower ends of the box, (n,), rad/s (m/s).
        hi: Upper ends, (n,).
        rows: Velocity dampers ``rows`` qd >= ``least``, (k, n).
        least: (k,).
        band_rows: Rows of the bands, (b, n).
        band_least: v, (b,).
        weight: W, (n, n), or :data:`ik_node.differential_ik.closed_form.IDENTITY`.

    Returns:
        s and qd, (n,); NaN if no s from 0 to ``wish`` is possible.
    """
    unit, fixed, per_scale = _inequalities(band_rows, band_least, rows, least, lo, hi)
    null, along = np.ascontiguousarray(svd.vt[svd.rank :]), ray
    move, slopes = null, unit @ null.T
    if len(weight) and len(null):
        move = np.linalg.inv(np.linalg.cholesky(null @ weight @ null.T)) @ null
        along = ray - (move @ (weight @ ray)) @ move
    rows_y, scale = unit @ move.T, wish
    is_fixed = (slopes * slopes).sum(axis=1) < MIN_SLOPE * MIN_SLOPE
    rows_y[is_fixed] = 0.0
    change = per_scale - unit @ along
    begin = fixed - unit @ free + wish * (unit @ along)
    for _ in range(MAX_SCALES):
        found, y, multipliers = nearest_point(rows_y, begin + scale * change)
        if found:
            velocity = free + (scale - wish) * along + y @ move
            missing = np.where(is_fixed, fixed + scale * per_scale - unit @ velocity, 0.0)
            row = int(np.argmax(missing))
            if missing[row] <= ROUNDING:
                return scale if np.all(np.isfinite(velocity)) else np.nan, np.minimum(np.maximum(velocity, lo), hi)
            slope, largest = change[row], missing[row] - scale * change[row]
        else:
            slope, largest = float(multipliers @ change), float(multipliers @ begin)
        if not slope > 0.0 or largest > ROUNDING * slope:
            break
        scale = min(max(-largest / slope, 0.0), (1.0 - SCALE_STEP) * scale)
    return np.nan, free


@compiled
def nearest_point(rows: Array, least: Array) -> tuple[bool, Array, Array]:
    r"""The y (d,) of least \|y\| with ``rows`` y >= ``least``, rows of length 1 or less.

    Args:
        rows: (k, d).
        least: (k,).

    Returns:
        Whether it was found; y; and if there is none, multipliers (k,) >= 0 of rows whose sum is zero while the sum of
        their ``least`` is not.
    """
    k, d = rows.shape
    y, multipliers, active, count = np.zeros(d), np.zeros(d), np.zeros(d, dtype=np.int64), 0
    is_active, conflict = np.zeros(k, dtype=np.bool_), np.zeros(k)
    for _ in range(MAX_CHANGES):
        new = _most_violated(rows, least, y, is_active)
        if new < 0:
            exact = np.abs(rows[active[:count]] @ y - least[active[:count]])
            return bool(np.all(exact <= MAX_VIOLATION)), y, conflict
        multiplier = 0.0
        while not is_active[new]:
            step, change = _independent_part(rows[active[:count]], rows[new])
            size, whole, part, blocking = step @ step, np.inf, np.inf, -1
            noise = MIN_INDEPENDENCE + ROW_NOISE * np.abs(change).sum()
            if count < d and size > noise * noise:
                whole = (least[new] - rows[new] @ y) / size
            for i in range(count):
                if change[i] > 0.0 and max(multipliers[i], 0.0) < part * change[i]:
                    part, blocking = max(multipliers[i], 0.0) / change[i], i
            length = min(whole, part)
            if not np.isfinite(length):
                conflict[new] = 1.0
                for i in range(count):
                    conflict[active[i]] = -change[i]
                return False, y, conflict
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
    return False, y, conflict


@compiled
def _independent_part(held: Array, row: Array) -> tuple[Array, Array]:
    """The part of ``row`` (d,) that is orthogonal to the rows ``held`` (c, d), and the factors of the other part."""
    step, change = row.copy(), np.zeros(len(held))
    if len(held):
        q, r = np.linalg.qr(np.ascontiguousarray(held.T))
        for _ in range(2):  # the second time removes the rounding of nearly dependent rows
            factors = np.linalg.solve(r, np.ascontiguousarray(q.T) @ step)
            change, step = change + factors, step - factors @ held
    return step, change


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
) -> tuple[Array, Array, Array]:
    """Bands, dampers, lower and upper ends of the box as rows of unit length, and their limits at s = 0 and per s.

    Rows without length always hold.
    """
    b, k, n = len(band_least), len(least), len(lo)
    unit, fixed, per_scale = np.zeros((b + k + 2 * n, n)), np.full(b + k + 2 * n, -1.0), np.zeros(b + k + 2 * n)
    for i in range(b + k):
        row = band_rows[i] if i < b else rows[i - b]
        size = np.sqrt(row @ row)
        if size > ROUNDING:
            unit[i] = row / size
            fixed[i], per_scale[i] = (0.0, band_least[i] / size) if i < b else (least[i - b] / size, 0.0)
    for j in range(n):
        unit[b + k + j, j], fixed[b + k + j] = 1.0, lo[j]
        unit[b + k + n + j, j], fixed[b + k + n + j] = -1.0, -hi[j]
    return unit, fixed, per_scale

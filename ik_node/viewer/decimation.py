"""Reduction of lines for display: few points, with all extreme values kept."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.math.types import Array

MAX_ROWS = 400
"""Per plot."""
MAX_PATH_POINTS = 8000
"""Per path in 3-D."""
PATH_STEP_M = 5e-4
"""Distance between points of a path, if that gives no more than MAX_PATH_POINTS."""


def decimate(times_s: Array, values: Array, max_rows: int = MAX_ROWS) -> tuple[Array, Array]:
    """Min-max decimation of several columns on one time axis.

    Each block of neighbouring rows becomes two rows: minimum and maximum of each column in their order of appearance,
    at the times of the begin and the middle of the block; a column without finite values there becomes NaN. An extreme
    value may therefore be displayed earlier by at most the length of a block.

    Args:
        times_s: (k,), increasing.
        values: (k, m).
        max_rows: Even number of rows above which the input is decimated.

    Returns:
        Times and values of at most ``max_rows`` rows.
    """
    if len(times_s) <= max_rows:
        return times_s, values
    blocks = max_rows // 2
    edges = np.linspace(0, len(times_s), blocks + 1).astype(np.int64)[:-1]
    lengths = np.diff(np.append(edges, len(times_s)))
    finite = np.isfinite(values)
    low = np.minimum.reduceat(np.where(finite, values, np.inf), edges, axis=0)
    high = np.maximum.reduceat(np.where(finite, values, -np.inf), edges, axis=0)
    first_low = _first_row(values, low, edges, lengths)
    first_high = _first_row(values, high, edges, lengths)
    begin = np.where(first_low <= first_high, low, high)
    end = np.where(first_low <= first_high, high, low)
    begin, end = np.where(np.isfinite(begin), begin, np.nan), np.where(np.isfinite(end), end, np.nan)
    rows = np.stack((edges, edges + lengths // 2), axis=1).ravel()
    return times_s[rows], np.stack((begin, end), axis=1).reshape(2 * blocks, -1)


def _first_row(values: Array, target: Array, edges: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """First row of every block and column with the value ``target``; the number of rows if there is none."""
    found = values == np.repeat(target, lengths, axis=0)
    rows = np.where(found, np.arange(len(values))[:, None], len(values))
    result: NDArray[np.int64] = np.minimum.reduceat(rows, edges, axis=0)
    return result


def path(points: Array, max_points: int = MAX_PATH_POINTS, step_m: float = PATH_STEP_M) -> Array:
    """Points (m, 3) of the polyline ``points`` (k, 3), about ``step_m`` apart; non-finite points are skipped."""
    kept = points[np.isfinite(points).all(axis=1)]
    if len(kept) < 2:
        return kept
    arc_length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=1))))
    step = max(step_m, float(arc_length[-1]) / max_points)
    _, rows = np.unique(np.floor(arc_length / step), return_index=True)
    return kept[np.append(rows, len(kept) - 1)] if rows[-1] != len(kept) - 1 else kept[rows]


def segments(points: Array) -> Array:
    """The line segments of a polyline (m, 3), (m - 1, 2, 3)."""
    return np.stack((points[:-1], points[1:]), axis=1) if len(points) > 1 else np.zeros((0, 2, 3))

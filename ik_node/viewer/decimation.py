"""The lines of the plots: every peak kept, few enough points for a page that is redrawn while it plays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.math.types import Array

MOST_ROWS = 400
"""Per plot."""
MOST_PATH_POINTS = 8000
"""Per path in space."""
PATH_STEP_M = 5e-4
"""Distance between points of a path, unless that makes too many."""


def thin(times_s: Array, values: Array, most: int = MOST_ROWS) -> tuple[Array, Array]:
    """At most ``most`` (even) rows of ``values`` (k, m) on one time axis, with the extremes of every column.

    Neighbouring rows become two: the least and the largest of each column, in the order in which they came. A column
    that holds nothing finite there becomes NaN. Times are those of the begin and of the middle of the neighbours: a
    peak may be shown earlier by up to as long as they last.
    """
    if len(times_s) <= most:
        return times_s, values
    blocks = most // 2
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


def _first_row(values: Array, wanted: Array, edges: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """For every block and column the first row that holds ``wanted``; the number of rows where none does."""
    found = values == np.repeat(wanted, lengths, axis=0)
    rows = np.where(found, np.arange(len(values))[:, None], len(values))
    result: NDArray[np.int64] = np.minimum.reduceat(rows, edges, axis=0)
    return result


def path(points: Array, most: int = MOST_PATH_POINTS, step_m: float = PATH_STEP_M) -> Array:
    """Points (m, 3) of the way through ``points`` (k, 3), about ``step_m`` apart along it; what is not finite is left
    out."""
    kept = points[np.isfinite(points).all(axis=1)]
    if len(kept) < 2:
        return kept
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=1))))
    step = max(step_m, float(way[-1]) / most)
    _, rows = np.unique(np.floor(way / step), return_index=True)
    return kept[np.append(rows, len(kept) - 1)] if rows[-1] != len(kept) - 1 else kept[rows]


def segments(points: Array) -> Array:
    """A polyline (m, 3) as its pieces, (m - 1, 2, 3)."""
    return np.stack((points[:-1], points[1:]), axis=1) if len(points) > 1 else np.zeros((0, 2, 3))

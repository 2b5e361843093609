"""Least squares with bounds on every unknown, by an active set: exact to rounding, compiled.

P. Stark, R. Parker, "Bounded-Variable Least-Squares: an Algorithm and Applications", Computational Statistics 1995.
The unknowns at a bound are held there; the free ones solve the remaining least squares problem, or go towards its
solution until the first of them reaches a bound. Then the bound whose gradient points inwards most is released.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.types import Array

MIN_GRADIENT = 1e-14
"""Gradients up to this, relative to the norms of their column and of b, are rounding."""

MAX_CHANGES = 200
"""Changes of the active set, after which the present point is returned; 12 are usual at most."""


@compiled
def bounded_least_squares(a: Array, b: Array, lo: Array, hi: Array, start: Array) -> Array:
    """The x (n,) of least \\|A x - b\\| with ``lo`` <= x <= ``hi``; exactly within the bounds.

    Args:
        a: A, (m, n), of full column rank, C-contiguous.
        b: (m,).
        lo: (n,); may be -inf.
        hi: (n,), hi >= lo; may be inf.
        start: A first point, (n,).
    """
    n = a.shape[1]
    x = np.minimum(np.maximum(start, lo), hi)
    free = (x > lo) & (x < hi)
    smallest = np.empty(n)
    size = MIN_GRADIENT * np.sqrt(b @ b)
    for i in range(n):
        smallest[i] = size * np.sqrt((a[:, i] ** 2).sum())
    released = -1
    for _ in range(MAX_CHANGES):
        if _go_to_optimum(a, b, lo, hi, x, free):
            released = -1
            continue
        gradient = a.T @ (b - a @ x)
        best, found = 0.0, -1
        for i in range(n):
            if not free[i] and lo[i] < hi[i]:
                inwards = gradient[i] if x[i] <= lo[i] else -gradient[i]
                if inwards > smallest[i] and inwards > best and i != released:
                    best, found = inwards, i
        if found < 0:
            break
        released = found
        free[found] = True
    return x


@compiled
def _go_to_optimum(a: Array, b: Array, lo: Array, hi: Array, x: Array, free: NDArray[np.bool_]) -> bool:
    """Moves the free unknowns to their optimum; True if one of them reached a bound, and is held there, before."""
    indices = np.flatnonzero(free)
    if len(indices) == 0:
        return False
    columns = np.empty((len(a), len(indices)))
    rest = b - a @ x
    for k in range(len(indices)):
        columns[:, k] = a[:, indices[k]]
    change = np.linalg.lstsq(columns, rest)[0]
    ratio, reached = 1.0, -1
    for k in range(len(indices)):
        i = indices[k]
        room = (hi[i] if change[k] > 0.0 else lo[i]) - x[i]
        if abs(change[k]) * ratio > abs(room):
            ratio, reached = abs(room / change[k]), k
    for k in range(len(indices)):
        i = indices[k]
        x[i] = min(max(x[i] + ratio * change[k], lo[i]), hi[i])
    if reached < 0:
        return False
    i = indices[reached]
    x[i] = hi[i] if change[reached] > 0.0 else lo[i]
    free[i] = False
    return True

"""Small numerical functions that several rooms share: smoothstep, low-discrepancy points, checks of input."""

from __future__ import annotations

from functools import cache
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.types import Array


@compiled
def smoothstep(x: float) -> float:
    """The cubic x^2 (3 - 2 x) for 0 <= x <= 1; 0 below and 1 above. Its slope is continuous; smoothstep(x) <= 9/8 x."""
    x = np.minimum(np.maximum(x, 0.0), 1.0)  # unlike min and max, these propagate NaN
    return x * x * (3.0 - 2.0 * x)


@compiled
def smoothstep_ratio(x: float) -> float:
    """smoothstep(x) / x = x (3 - 2 x) for 0 <= x <= 1, without a division; not clamped."""
    return x * (3.0 - 2.0 * x)


def low_discrepancy_points(indices: ArrayLike, dimensions: int) -> Array:
    """Points of the additive recurrence of the generalised golden ratio, which fill the unit cube evenly.

    Source: M. Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018.

    Args:
        indices: Numbers of the points, an integer or integers (k,); point 0 is the centre of the cube.
        dimensions: Dimension d of the cube.

    Returns:
        The points, (d,) for one index, else (k, d), each entry in [0, 1). The same for every call.
    """
    return np.asarray((0.5 + np.asarray(indices)[..., None] * _recurrence_steps(dimensions)) % 1.0)


@cache
def _recurrence_steps(dimensions: int) -> Array:
    """Powers -1 .. -d of the root > 1 of x^(d + 1) = x + 1."""
    root = 1.5
    for _ in range(50):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    return np.asarray(1.0 / root ** np.arange(1, dimensions + 1))


def checked_vector(values: ArrayLike, size: int, name: str) -> Array:
    """``values`` as a finite float vector (size,); InputError naming ``name`` otherwise."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InputError(f"{name} has shape {array.shape}, expected ({size},)")
    if not all(map(isfinite, array.tolist())):
        raise InputError(f"{name} is not finite: {array}")
    return array


def checked_positive_vector(values: ArrayLike, size: int, name: str) -> Array:
    """``values``, one number or (size,), as a finite vector (size,) of numbers > 0; InputError otherwise."""
    array = np.asarray(values, dtype=np.float64)
    array = checked_vector(np.full(size, array) if array.ndim == 0 else array, size, name)
    if array.min() <= 0.0:
        raise InputError(f"{name} is {array.tolist()}; expected numbers > 0")
    return array


def checked_matrix(values: ArrayLike, name: str) -> Array:
    """``values`` as a finite, non-empty float matrix; InputError naming ``name`` otherwise."""
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise InputError(f"{name} has shape {matrix.shape}, expected (m, n) with m, n >= 1")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} is not finite: {matrix.tolist()}")
    return matrix


def checked_positive_definite(values: ArrayLike, size: int, name: str) -> Array:
    """``values`` as a symmetric positive definite matrix (size, size); InputError naming ``name`` otherwise.

    Symmetric means within 1e-8 of the largest entry; the mean of the matrix and its transpose is returned.
    """
    matrix = checked_matrix(values, name)
    if matrix.shape != (size, size):
        raise InputError(f"{name} has shape {matrix.shape}, expected ({size}, {size})")
    asymmetry = float(np.abs(matrix - matrix.T).max())
    if asymmetry > 1e-8 * float(np.abs(matrix).max()):
        raise InputError(f"{name} is not symmetric: entries differ by {asymmetry:.3g}")
    symmetric: Array = 0.5 * (matrix + matrix.T)
    try:
        np.linalg.cholesky(symmetric)
    except np.linalg.LinAlgError:
        smallest = float(np.linalg.eigvalsh(symmetric)[0])
        raise InputError(f"{name} is not positive definite: smallest eigenvalue {smallest:.3g}") from None
    return symmetric


def check_positive(**values: float) -> None:
    """InputError naming the first of ``values`` that is not a finite number > 0."""
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise InputError(f"{name} is {value}; expected a number > 0")


def check_not_negative(**values: float) -> None:
    """InputError naming the first of ``values`` that is not a finite number >= 0."""
    for name, value in values.items():
        if not 0.0 <= value < np.inf:
            raise InputError(f"{name} is {value}; expected a number >= 0")


def check_count(least: int = 0, **values: int) -> None:
    """InputError naming the first of ``values`` that is less than ``least``."""
    for name, value in values.items():
        if value < least:
            raise InputError(f"{name} is {value}; expected a count >= {least}")

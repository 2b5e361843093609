"""The Moore-Penrose pseudoinverse, as the notes need it: square, fat, tall, rank-deficient, weighted.

The notes write J' (J J')^-1 and (J' J)^-1 J'. The same matrices are computed here by LU and QR, because forming J J'
squares the condition number: at a smallest singular value of 1e-7 the printed formula keeps 3 digits, these keep 8.
The notes' last line of the tall case, (J J')^-1 J', is a slip (not even conformable); the left inverse it means is
(J' J)^-1 J'.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.types import Array

EPSILON = float(np.finfo(np.float64).eps)


class Pseudoinverse(NamedTuple):
    """A pseudoinverse and how it came about."""

    matrix: Array
    """J^+, (n, m)."""
    rank: int
    """Singular values above ``cutoff``."""
    singular_values: Array
    """Of J, descending, (min(m, n),)."""
    cutoff: float
    """Singular values up to this one count as zero."""
    kind: str
    """``square``, ``right inverse``, ``left inverse``, ``truncated``, ``damped`` or ``weighted``."""


class Decomposition(NamedTuple):
    """J = U S V' with the numerical rank."""

    u: Array
    """Left singular vectors, (m, min(m, n))."""
    sigma: Array
    """Singular values, descending, (min(m, n),)."""
    vt: Array
    """Right singular vectors as rows, (n, n): those after the first min(m, n) span the structural null space."""
    rank: int
    """Singular values above ``cutoff``."""
    cutoff: float
    """Singular values up to this one count as zero."""


def finite_matrix(values: ArrayLike, name: str) -> Array:
    """``values`` as a finite, non-empty float matrix; InputError naming ``name`` otherwise."""
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise InputError(f"{name} has shape {matrix.shape}, expected (m, n) with m, n >= 1")
    if not np.isfinite(matrix).all():
        raise InputError(f"{name} is not finite: {matrix.tolist()}")
    return matrix


def positive_definite(values: ArrayLike, size: int, name: str) -> Array:
    """``values`` as a symmetric positive definite matrix (size, size); InputError naming ``name`` otherwise.

    Symmetric means within 1e-8 of its largest entry; the mean with its transpose is returned.
    """
    matrix = finite_matrix(values, name)
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


def decompose(matrix: Array, name: str = "matrix", rcond: float | None = None) -> Decomposition:
    """Singular value decomposition of ``matrix`` (m, n) with its numerical rank.

    Singular values up to ``rcond`` times the largest count as zero; the default is 10 max(m, n) times the rounding
    unit (some 1e-14), so that only rounding is cut off. InputError naming ``name`` where the matrix is not finite.
    """
    rows, columns = matrix.shape
    try:
        return decomposition(np.ascontiguousarray(matrix), max(rows, columns) * EPSILON if rcond is None else rcond)
    except np.linalg.LinAlgError:
        raise InputError(f"{name} has no singular value decomposition: {matrix.tolist()}") from None


@compiled
def decomposition(matrix: Array, rcond: float) -> Decomposition:
    """:func:`decompose` of a C-contiguous matrix; np.linalg.LinAlgError where it is not finite."""
    rows, columns = matrix.shape
    u, sigma, vt = np.linalg.svd(matrix, columns > rows)
    cutoff, rank = rcond * sigma[0], 0
    while rank < len(sigma) and sigma[rank] > cutoff:
        rank += 1
    return Decomposition(np.ascontiguousarray(u), sigma, np.ascontiguousarray(vt), rank, cutoff)


def pseudoinverse(matrix: ArrayLike, *, rcond: float | None = None, damping: float = 0.0) -> Pseudoinverse:
    """J^+ of ``matrix`` J (m, n); of full rank by LU or QR, else by what the caller chose.

    ``damping`` > 0, in the unit of J: J' (J J' + damping^2 I)^-1, the damped inverse, at every rank (Wampler 1986).
    ``damping`` = 0 and J rank-deficient: singular values up to ``rcond`` times the largest are left out (truncated).
    Full rank: square J^-1 by LU; fat J' (J J')^-1, the right inverse, as Q R'^-1 with J' = Q R; tall (J' J)^-1 J', the
    left inverse, as R^-1 Q' with J = Q R.

    Raises InputError when ``matrix`` is no finite matrix, or ``damping`` or ``rcond`` negative or not finite.
    """
    jacobian = finite_matrix(matrix, "matrix")
    for name, value in (("damping", damping), ("rcond", 0.0 if rcond is None else rcond)):
        if not 0.0 <= value < np.inf:
            raise InputError(f"{name} is {value}; expected a number >= 0")
    rows, columns = jacobian.shape
    parts = decompose(jacobian, "matrix", rcond)
    sigma, size = parts.sigma, len(parts.sigma)
    if damping > 0.0:
        result, kind = (parts.vt[:size].T * (sigma / (sigma**2 + damping**2))) @ parts.u.T, "damped"
    elif parts.rank < size:
        kept = slice(0, parts.rank)
        result, kind = (parts.vt[kept].T / sigma[kept]) @ parts.u[:, kept].T, "truncated"
    elif rows == columns:
        result, kind = np.linalg.inv(jacobian), "square"
    elif rows < columns:
        q, r = np.linalg.qr(jacobian.T)
        result, kind = np.linalg.solve(r, q.T).T, "right inverse"
    else:
        q, r = np.linalg.qr(jacobian)
        result, kind = np.linalg.solve(r, q.T), "left inverse"
    return Pseudoinverse(result, parts.rank, sigma, parts.cutoff, kind)


def apply(matrix: Array, right: Array, *, cutoff: float = 0.0, damping: float = 0.0) -> tuple[Array, int]:
    """J^+ ``right`` and the rank of ``matrix`` J (m, n), without forming J^+; for use in an iteration, unchecked.

    Singular values up to ``cutoff`` (absolute; rounding at least) are left out; ``damping`` as for the whole matrix.
    """
    u, sigma, vt, _, rounding = decompose(matrix, "jacobian")
    rank = int(np.count_nonzero(sigma > max(cutoff, rounding)))
    kept = sigma[:rank]
    scaled = (u[:, :rank].T @ right) * (kept / (kept * kept + damping * damping) if damping else 1.0 / kept)
    return scaled @ vt[:rank], rank


def weighted_pseudoinverse(matrix: ArrayLike, weight: ArrayLike, *, rcond: float | None = None) -> Pseudoinverse:
    """J_W^+ of ``matrix`` J (m, n) with ``weight`` W (n, n): among the qd that come closest to J qd = V it picks the
    one of least qd' W qd.

    At full row rank this is the notes' W^-1 J' (J W^-1 J')^-1. That formula does not exist for tall or singular J;
    what is returned then obeys the same weighted Penrose conditions (J J_W^+ and W J_W^+ J symmetric). Computed as
    P V S^-1 U' with P = I - N (N' W N)^-1 N' W and N a basis of the null space, whose condition is W's, not J's.

    Raises InputError when ``matrix`` is no finite matrix, or ``weight`` not symmetric positive definite (n, n).
    """
    jacobian = finite_matrix(matrix, "matrix")
    mass = positive_definite(weight, jacobian.shape[1], "weight")
    parts = decompose(jacobian, "matrix", rcond)
    kept = slice(0, parts.rank)
    particular = (parts.vt[kept].T / parts.sigma[kept]) @ parts.u[:, kept].T
    null = parts.vt[parts.rank :].T
    if null.shape[1]:
        particular = particular - null @ np.linalg.solve(null.T @ mass @ null, null.T @ (mass @ particular))
    kind = "truncated" if parts.rank < len(parts.sigma) else "weighted"
    return Pseudoinverse(particular, parts.rank, parts.sigma, parts.cutoff, kind)

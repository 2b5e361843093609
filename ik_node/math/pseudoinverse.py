"""The Moore-Penrose pseudoinverse of the lecture notes: square, fat, tall or rank-deficient J.

The notes write::

    fat J:   J^+ = J' (J J')^-1            tall J:   J^+ = (J' J)^-1 J'

The same matrices are computed here by LU and QR, because forming J J' squares the condition number: at a smallest
singular value of 1e-7 the printed formula keeps 3 digits, this module keeps 8. The notes' last line of the tall case,
(J J')^-1 J', is an error: its factors are not conformable. The weighted pseudoinverse is computed by
:func:`ik_node.differential_ik.closed_form.resolve`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError
from ik_node.jit import compiled
from ik_node.math.numerics import check_not_negative, checked_matrix
from ik_node.math.types import Array

EPSILON = float(np.finfo(np.float64).eps)


class Pseudoinverse(NamedTuple):
    """A pseudoinverse and how it was computed."""

    matrix: Array
    """J^+, (n, m)."""
    rank: int
    """Number of singular values above ``cutoff``."""
    singular_values: Array
    """Of J, descending, (min(m, n),)."""
    cutoff: float
    """Singular values up to this one count as zero."""
    kind: str
    """``square``, ``right inverse``, ``left inverse``, ``truncated`` or ``damped``."""


class Decomposition(NamedTuple):
    """The singular value decomposition J = U S Y' and the numerical rank."""

    u: Array
    """Left singular vectors, (m, min(m, n))."""
    sigma: Array
    """Singular values, descending, (min(m, n),)."""
    vt: Array
    """Y': right singular vectors as rows, (n, n). The rows after the first min(m, n) span the structural null space."""
    rank: int
    """Number of singular values above ``cutoff``."""
    cutoff: float
    """Singular values up to this one count as zero."""


def decompose(matrix: Array, name: str = "matrix", rcond: float | None = None) -> Decomposition:
    """Singular value decomposition with numerical rank.

    Args:
        matrix: (m, n), finite.
        name: What the error message calls ``matrix``.
        rcond: Singular values up to ``rcond`` times the largest count as zero. The default, max(m, n) times the
            rounding unit, cuts off rounding only.

    Raises:
        InputError: ``matrix`` is not finite.
    """
    rows, columns = matrix.shape
    try:
        return svd_with_rank(np.ascontiguousarray(matrix), max(rows, columns) * EPSILON if rcond is None else rcond)
    except np.linalg.LinAlgError:
        raise InputError(f"{name} has no singular value decomposition: {matrix.tolist()}") from None


@compiled
def svd_with_rank(matrix: Array, rcond: float) -> Decomposition:
    """:func:`decompose` of a C-contiguous matrix; raises np.linalg.LinAlgError if it is not finite."""
    rows, columns = matrix.shape
    u, sigma, vt = np.linalg.svd(matrix, columns > rows)
    cutoff, rank = rcond * sigma[0], 0
    while rank < len(sigma) and sigma[rank] > cutoff:
        rank += 1
    return Decomposition(np.ascontiguousarray(u), sigma, np.ascontiguousarray(vt), rank, cutoff)


def pseudoinverse(matrix: ArrayLike, *, rcond: float | None = None, damping: float = 0.0) -> Pseudoinverse:
    """The pseudoinverse J^+ of a matrix J of any shape and rank.

    Full rank: J^-1 by LU if square; the right inverse J' (J J')^-1 = Q R'^-1 with J' = Q R if fat; the left inverse
    (J' J)^-1 J' = R^-1 Q' with J = Q R if tall. Rank-deficient: the truncated inverse, from the singular values above
    the cutoff. With damping, at every rank: J' (J J' + damping^2 I)^-1 (Wampler 1986).

    Args:
        matrix: J, (m, n).
        rcond: Relative cutoff of singular values, see :func:`decompose`.
        damping: >= 0, in the unit of J; 0 means undamped.

    Raises:
        InputError: ``matrix`` is not a finite matrix, or ``damping`` or ``rcond`` is negative or not finite.
    """
    jacobian = checked_matrix(matrix, "matrix")
    check_not_negative(damping=damping, rcond=0.0 if rcond is None else rcond)
    rows, columns = jacobian.shape
    svd = decompose(jacobian, "matrix", rcond)
    sigma, size = svd.sigma, len(svd.sigma)
    if damping > 0.0:
        result, kind = (svd.vt[:size].T * (sigma / (sigma**2 + damping**2))) @ svd.u.T, "damped"
    elif svd.rank < size:
        kept = slice(0, svd.rank)
        result, kind = (svd.vt[kept].T / sigma[kept]) @ svd.u[:, kept].T, "truncated"
    elif rows == columns:
        result, kind = np.linalg.inv(jacobian), "square"
    elif rows < columns:
        q, r = np.linalg.qr(jacobian.T)
        result, kind = np.linalg.solve(r, q.T).T, "right inverse"
    else:
        q, r = np.linalg.qr(jacobian)
        result, kind = np.linalg.solve(r, q.T), "left inverse"
    return Pseudoinverse(result, svd.rank, sigma, svd.cutoff, kind)


def apply_pseudoinverse(matrix: Array, right: Array, *, cutoff: float = 0.0, damping: float = 0.0) -> tuple[Array, int]:
    """The product J^+ ``right`` and the rank of J, without forming J^+ and without checks.

    Args:
        matrix: J, (m, n).
        right: (m,).
        cutoff: Singular values up to this one (absolute, at least rounding) are truncated.
        damping: As for :func:`pseudoinverse`.
    """
    u, sigma, vt, _, rounding = decompose(matrix, "jacobian")
    rank = int(np.count_nonzero(sigma > max(cutoff, rounding)))
    kept = sigma[:rank]
    scaled = (u[:, :rank].T @ right) * (kept / (kept * kept + damping * damping) if damping else 1.0 / kept)
    return scaled @ vt[:rank], rank

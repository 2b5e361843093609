"""Out of a singularity with the freedom that the task leaves.

::

    h = F r / 4 (1 - sigma / r)^4    for the smallest singular value sigma of J (rows scaled) below r, 0 above

It leads an arm away that started singular, where V alone cannot. Only the null space follows a gradient, so only the
part of grad_h along it is computed: two evaluations of J for each of its dimensions, and none while sigma is above r.
As a part of ``obstacle_gradient`` it was tried and left out: of 60 scenes it spoilt more than it mended.
"""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential, push
from ik_node.differential_ik.singular_directions import STEP, JacobianAt
from ik_node.math.types import Array

SPAN_M = 0.08
"""r, rotations times the characteristic length."""


def dexterity(jacobian_at: JacobianAt, q: Array, row_scale: Array, strength: float, span: float = SPAN_M) -> Potential:
    """h at q (n,), and the part of grad_h in the null space of J (m, n) there.

    ``row_scale`` (m,) makes rotations comparable with translations; ``strength`` F in N; ``span`` r in m.
    """
    jacobian = jacobian_at(q)
    gradient = np.zeros(len(q))
    if jacobian.shape[0] >= len(q):
        return Potential(0.0, gradient)
    u, sigma, rows = np.linalg.svd(row_scale[:, None] * jacobian)
    smallest = len(sigma) - 1
    if sigma[smallest] >= span:
        return Potential(0.0, gradient)
    value, slope = push(sigma[smallest:], np.array([span]))
    for free in rows[len(sigma) :]:
        change = row_scale[:, None] * (jacobian_at(q + STEP * free) - jacobian_at(q - STEP * free)) / (2.0 * STEP)
        gradient += float(slope[0] * (u[:, smallest] @ change @ rows[smallest])) * free
    return Potential(strength * float(value[0]), strength * gradient)

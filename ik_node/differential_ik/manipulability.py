"""Potential of the smallest singular value: leads an arm out of a singularity along its null space.

::

    h = F r / 4 (1 - sigma / r)^4    for the smallest singular value sigma of J (rows scaled) below r, 0 above

It moves an arm that starts at a singularity, where V alone cannot. Only the null space follows a gradient, therefore
only the component of grad_h in it is computed: two evaluations of J for each of its dimensions, and none while sigma
exceeds r. As a term of ``obstacle_gradient`` it made more of 60 scenes worse than better and was left out.
"""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential, repulsion_profile
from ik_node.differential_ik.singular_directions import STEP, JacobianAt
from ik_node.math.types import Array

SPAN_M = 0.08
"""r, rotations times the characteristic length, m."""


def manipulability_potential(
    jacobian_at: JacobianAt, q: Array, row_scale: Array, strength: float, span: float = SPAN_M
) -> Potential:
    """h at q, and the component of grad_h in the null space of J.

    Args:
        jacobian_at: J (m, n) of joint positions.
        q: Joint positions, (n,), rad (m).
        row_scale: Factors of the rows of J, (m,), that make rotations comparable with translations.
        strength: F, N.
        span: r, m.
    """
    jacobian = jacobian_at(q)
    gradient = np.zeros(len(q))
    if jacobian.shape[0] >= len(q):
        return Potential(0.0, gradient)
    u, sigma, rows = np.linalg.svd(row_scale[:, None] * jacobian)
    smallest = len(sigma) - 1
    if sigma[smallest] >= span:
        return Potential(0.0, gradient)
    value, slope = repulsion_profile(sigma[smallest:], np.array([span]))
    for free in rows[len(sigma) :]:
        change = row_scale[:, None] * (jacobian_at(q + STEP * free) - jacobian_at(q - STEP * free)) / (2.0 * STEP)
        gradient += float(slope[0] * (u[:, smallest] @ change @ rows[smallest])) * free
    return Potential(strength * float(value[0]), strength * gradient)

"""Staying clear of singularities with the freedom that is left: what avoids an obstacle must not stretch the arm.

::

    h = F r / 4 (1 - sigma / r)^4    for the smallest singular value sigma of J (rows scaled) below r, 0 above

It is to be added to other gradients, and strong: a stretched arm cannot follow its tool, which costs more than a near
miss. It is best asked where the arm is going to be in ``LOOK_AHEAD_S``, since close to a singularity the task itself
moves the joints faster than the null space may. Only the null space follows a gradient, so only the part of grad_h
along it is computed: two evaluations of J for each of its dimensions, and none while sigma is above r.
"""

from __future__ import annotations

import numpy as np

from ik_node.potentials.avoidance import Potential, push
from ik_node.se3 import Array
from ik_node.singular_view import STEP, JacobianAt

LOOK_AHEAD_S = 0.5
"""Half a second of the present joint velocities."""

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

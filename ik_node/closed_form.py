"""The optimum of a tick where nothing stands in its way: the closed form of the notes, compiled in one piece.

Nearly every tick of nearly every run ends here. What it takes for granted it verifies: no singularity is near, and the
answer lies within every limit of this tick, none of which had to give way. Where that does not hold, the answer counts
for nothing, and the same problem goes to :mod:`ik_node.singularity` and :mod:`ik_node.bounded`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.compiled import compiled
from ik_node.limits import JointBounds, MotionLimits, joint_bounds, nothing_conceded
from ik_node.pseudoinverse import EPSILON, decomposition
from ik_node.resolution import solution
from ik_node.se3 import Array


class ClosedForm(NamedTuple):
    """An answer, if it ``holds``."""

    holds: bool
    joint_velocity: Array
    """(n,), rad/s (m/s)."""
    multiplier_task: Array
    multiplier_potential: Array
    singular_values: Array
    """Of J with its rows times ``row_scale``, descending."""


@compiled
def closed_form(
    jacobian: Array,
    twist: Array,
    row_scale: Array,
    threshold: float,
    weight: Array,
    gradient: Array,
    gain: float,
    cap: Array,
    limits: MotionLimits,
    q: Array,
    previous: Array,
    elapsed_s: float,
    rows: Array,
    least: Array,
) -> ClosedForm:
    """What :func:`ik_node.resolution.resolve` says, and whether that is all there is to say.

    ``jacobian`` to ``cap`` as for :func:`ik_node.resolution.solution`, but for ``threshold``: singular values from this
    one on are far from zero. ``q`` (n,) measured, ``previous`` (n,) the command that has stood for ``elapsed_s``.
    ``rows`` (k, n) qd >= ``least`` (k,): dampers. np.linalg.LinAlgError where J is not finite.
    """
    m, n = jacobian.shape
    scaled = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            scaled[i, j] = row_scale[i] * jacobian[i, j]
    parts = decomposition(scaled, max(m, n) * EPSILON)
    free = solution(jacobian, twist, weight, gradient, gain, 0.0, row_scale, cap, parts)
    bounds = joint_bounds(limits, q, previous, elapsed_s)
    holds = (
        parts.sigma[-1] >= threshold and nothing_conceded(bounds) and _fits(free.joint_velocity, bounds, rows, least)
    )
    return ClosedForm(holds, free.joint_velocity, free.multiplier_task, free.multiplier_potential, parts.sigma)


@compiled
def _fits(velocity: Array, bounds: JointBounds, rows: Array, least: Array) -> bool:
    for i in range(len(velocity)):
        if not bounds.lo[i] <= velocity[i] <= bounds.hi[i]:
            return False
    for k in range(len(least)):
        speed = 0.0
        for i in range(len(velocity)):
            speed += rows[k, i] * velocity[i]
        if not speed >= least[k]:
            return False
    return True

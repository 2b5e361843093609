"""The optimum of a usual tick in one compiled pass: the closed form, and where it does not fit, the bounded problem.

Usual is what nearly every tick is: no singularity is near, the limits of this tick agree with each other, dampers leave
the arm the right to stand still, and the null space has at most one dimension, or nothing binds. Where that is not so,
the answer says it, and the same problem goes through :mod:`ik_node.differential_ik.singularity` and :mod:`ik_node.differential_ik.constrained`, of whose
parts this is made.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.closed_form import solution
from ik_node.differential_ik.exact_program import BINDING, DAMPER_BINDING, line_of, search, unit_rows
from ik_node.jit import compiled
from ik_node.math.pseudoinverse import EPSILON, decomposition
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, joint_bounds, nothing_conceded

NO_SIDES = np.zeros(0, dtype=np.int8)
LOWER, UPPER = 1, 2


class Usual(NamedTuple):
    """The answer of a usual tick; of another one only ``usual`` means anything."""

    usual: bool
    joint_velocity: Array
    """(n,), rad/s (m/s)."""
    scale: float
    """s: the part of the twist that is done."""
    multiplier_task: Array
    """Of the closed form, as is the next, (m,)."""
    multiplier_potential: Array
    singular_values: Array
    """Of J with its rows times ``row_scale``, descending."""
    sides: NDArray[np.int8]
    """What binds: of each joint LOWER, UPPER, their sum or 0, then of each damper 1 or 0; none where nothing does."""


def per_joint_of(limits: MotionLimits, cap: Array) -> Array:
    """The arrays of ``limits``, and the fastest velocities in the null space, ``cap`` (n,), as rows.

    One array is handed to compiled code more quickly than a NamedTuple of them.
    """
    return np.stack((*limits[:4], cap))


@compiled
def usual_tick(
    jacobian: Array,
    twist: Array,
    row_scale: Array,
    threshold: float,
    weight: Array,
    gradient: Array,
    gain: float,
    per_joint: Array,
    dt_max_s: float,
    recovery_speed: float,
    q: Array,
    previous: Array,
    elapsed_s: float,
    rows: Array,
    least: Array,
) -> Usual:
    """The optimum, where the tick is a usual one.

    ``jacobian`` to ``gain`` as for :func:`ik_node.differential_ik.closed_form.solution`, but for ``threshold``: singular values from
    this one on are far from zero. ``per_joint`` (5, n), ``dt_max_s``, ``recovery_speed``: limits and null-space cap,
    see :func:`per_joint_of`. ``q`` (n,) measured, ``previous`` (n,) the command that has stood for ``elapsed_s``.
    ``rows`` (k, n) qd >= ``least`` (k,): dampers. np.linalg.LinAlgError where J is not finite.
    """
    limits = MotionLimits(per_joint[0], per_joint[1], per_joint[2], per_joint[3], dt_max_s, recovery_speed)
    m, n = jacobian.shape
    scaled = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            scaled[i, j] = row_scale[i] * jacobian[i, j]
    parts = decomposition(scaled, max(m, n) * EPSILON)
    free = solution(jacobian, twist, weight, gradient, gain, 0.0, row_scale, per_joint[4], parts)
    bounds = joint_bounds(limits, q, previous, elapsed_s)
    usual = parts.sigma[-1] >= threshold and nothing_conceded(bounds)
    velocity, scale, sides = free.joint_velocity, 1.0, NO_SIDES
    if usual and not _fits(velocity, bounds, rows, least):
        base = np.minimum(np.maximum(0.0, bounds.lo), bounds.hi)
        usual = n - parts.rank <= 1 and np.all(np.isfinite(velocity)) and _obeys(base, rows, least)
        if usual:
            units, limit = unit_rows(rows, least)
            line = line_of(parts, row_scale * twist, np.abs(twist).max())
            base_scale = np.nan if np.any(base != 0.0) else 0.0
            pull = free.gain * gradient if len(gradient) else np.zeros(n)
            found = search(line, bounds.lo, bounds.hi, units, limit, base, base_scale, weight, pull, velocity)
            velocity, scale = np.minimum(np.maximum(found.joint_velocity, bounds.lo), bounds.hi), found.scale
            usual = not np.isnan(scale) and np.all(np.isfinite(velocity))
            sides = _sides(velocity, bounds, units, limit)
    return Usual(usual, velocity, scale, free.multiplier_task, free.multiplier_potential, parts.sigma, sides)


@compiled
def _fits(velocity: Array, bounds: JointBounds, rows: Array, least: Array) -> bool:
    for i in range(len(velocity)):
        if not bounds.lo[i] <= velocity[i] <= bounds.hi[i]:
            return False
    return _obeys(velocity, rows, least)


@compiled
def _obeys(velocity: Array, rows: Array, least: Array) -> bool:
    for k in range(len(least)):  # noqa: SIM110 - compiled code has no all() of a generator
        if not rows[k] @ velocity >= least[k]:
            return False
    return True


@compiled
def _sides(velocity: Array, bounds: JointBounds, rows: Array, least: Array) -> NDArray[np.int8]:
    n = len(velocity)
    sides = np.zeros(n + len(least), dtype=np.int8)
    for i in range(n):
        sides[i] = LOWER * (velocity[i] <= bounds.lo[i] + BINDING) + UPPER * (velocity[i] >= bounds.hi[i] - BINDING)
    for k in range(len(least)):
        sides[n + k] = rows[k] @ velocity <= least[k] + DAMPER_BINDING
    return sides

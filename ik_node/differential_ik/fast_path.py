"""The control step away from singularities in one compiled pass: the closed form, or the constrained problem.

This fast path serves nearly every control step: no singularity is near, the limits of this step are compatible, zero
velocity obeys the velocity dampers, and the null space has at most one dimension or no constraint binds. Otherwise the
solution is marked as not valid, and the same problem goes through :mod:`ik_node.differential_ik.singularity` and
:mod:`ik_node.differential_ik.constrained`, from whose functions this pass is composed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.closed_form import closed_form
from ik_node.differential_ik.exact_program import BINDING, DAMPER_BINDING, solve_exactly, task_line, unit_rows
from ik_node.differential_ik.viable_scale import Prediction, needs_foresight, viable_scale
from ik_node.jit import compiled
from ik_node.math.pseudoinverse import EPSILON, svd_with_rank
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits, joint_bounds, nothing_relaxed

NO_SIDES = np.zeros(0, dtype=np.int8)
LOWER, UPPER = 1, 2
NO_ORDER = np.zeros(0, dtype=np.int64)


class FastSolution(NamedTuple):
    """The solution of the fast path; the other fields have a meaning only if ``valid``."""

    valid: bool
    joint_velocity: Array
    """(n,), rad/s (m/s)."""
    task_scale: float
    """s: the fraction of the twist that is executed."""
    viable_scale: float
    """The largest s from which the joints can brake along the twist."""
    multiplier_task: Array
    """First term of the multiplier of the closed form, (m,)."""
    multiplier_potential: Array
    """Second term of the multiplier of the closed form, (m,)."""
    singular_values: Array
    """Of J with its rows times ``row_scale``, descending."""
    off_direction: Array
    """J qd - s V, (m,); rounding, because this path applies only if limits permit a multiple of V."""
    sides: NDArray[np.int8]
    """Active constraints: LOWER, UPPER, their sum or 0 for each joint, then 1 or 0 for each damper; empty if none."""


def stacked_limits(limits: MotionLimits, null_space_cap: Array) -> Array:
    """The arrays of ``limits`` and ``null_space_cap`` (n,) as rows, (5, n).

    One array is passed to compiled code faster than a NamedTuple of arrays.
    """
    return np.stack((*limits[:4], null_space_cap))


@compiled
def solve_fast(
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
    order: NDArray[np.int64] = NO_ORDER,
    tolerance: float = 0.0,
) -> FastSolution:
    """The optimum under limits, if the fast path applies.

    Args:
        jacobian: J, (m, n), C-contiguous.
        twist: V, (m,).
        row_scale: Factors of the rows of J, (m,).
        threshold: Smallest singular value, in the unit of the scaled J, at which the fast path applies.
        weight: W, (n, n), or :data:`ik_node.differential_ik.closed_form.IDENTITY`.
        gradient: grad_h, (n,), or :data:`ik_node.differential_ik.closed_form.NO_GRADIENT`.
        gain: k, s.
        per_joint: Limits and null-space cap, see :func:`stacked_limits`.
        dt_max_s: Longest time for which a command is held, s.
        recovery_speed: Speed at which a joint outside its position limits is returned, rad/s (m/s).
        q: Measured joint positions, (n,).
        previous: The present command, (n,), rad/s (m/s).
        elapsed_s: For how long it has been held, s.
        rows: Velocity dampers ``rows`` qd >= ``least``, (k, n).
        least: (k,).
        order: Indices of the joints from the base to the tool, (n,); empty for none: the twist is not predicted.
        tolerance: Singular value below which predicted rates are bounded, m.

    Raises:
        np.linalg.LinAlgError: J is not finite.
    """
    limits = MotionLimits(per_joint[0], per_joint[1], per_joint[2], per_joint[3], dt_max_s, recovery_speed)
    m, n = jacobian.shape
    scaled = np.empty((m, n))
    for i in range(m):
        for j in range(n):
            scaled[i, j] = row_scale[i] * jacobian[i, j]
    svd = svd_with_rank(scaled, max(m, n) * EPSILON)
    free = closed_form(jacobian, twist, weight, gradient, gain, 0.0, row_scale, per_joint[4], svd)
    bounds = joint_bounds(limits, q, previous, elapsed_s)
    valid = svd.sigma[-1] >= threshold and nothing_relaxed(bounds)
    wish = 1.0
    if valid and len(order) == n and needs_foresight(free.task_velocity, scaled, svd.sigma[-1], q, limits):
        ahead = Prediction(jacobian, order, row_scale, twist, tolerance, np.ones(m))
        wish = viable_scale(ahead, q, previous, limits)
        if wish < 1.0:
            free = closed_form(jacobian, wish * twist, weight, gradient, gain, 0.0, row_scale, per_joint[4], svd)
    velocity, scale, sides = free.joint_velocity, wish, NO_SIDES
    if valid and not _is_feasible(velocity, bounds, rows, least):
        base = np.minimum(np.maximum(0.0, bounds.lo), bounds.hi)
        valid = n - svd.rank <= 1 and np.all(np.isfinite(velocity)) and _obeys(base, rows, least)
        if valid:
            units, limit = unit_rows(rows, least)
            line = task_line(svd, row_scale * twist, np.abs(twist).max())
            base_scale = np.nan if np.any(base != 0.0) else 0.0
            pull = free.gain * gradient if len(gradient) else np.zeros(n)
            solution = solve_exactly(
                line, bounds.lo, bounds.hi, units, limit, base, base_scale, weight, pull, velocity, wish
            )
            velocity = np.minimum(np.maximum(solution.joint_velocity, bounds.lo), bounds.hi)
            scale = solution.scale
            valid = not np.isnan(scale) and np.all(np.isfinite(velocity))
            sides = _active_sides(velocity, bounds, units, limit)
    off_direction = jacobian @ velocity - scale * twist
    return FastSolution(
        valid, velocity, scale, wish, free.multiplier_task, free.multiplier_potential, svd.sigma, off_direction, sides
    )


@compiled
def _is_feasible(velocity: Array, bounds: JointBounds, rows: Array, least: Array) -> bool:
    for i in range(len(velocity)):
        if not bounds.lo[i] <= velocity[i] <= bounds.hi[i]:
            return False
    return _obeys(velocity, rows, least)


@compiled
def _obeys(velocity: Array, rows: Array, least: Array) -> bool:
    for k in range(len(least)):  # noqa: SIM110 - numba does not compile all() of a generator
        if not rows[k] @ velocity >= least[k]:
            return False
    return True


@compiled
def _active_sides(velocity: Array, bounds: JointBounds, rows: Array, least: Array) -> NDArray[np.int8]:
    n = len(velocity)
    sides = np.zeros(n + len(least), dtype=np.int8)
    for i in range(n):
        sides[i] = LOWER * (velocity[i] <= bounds.lo[i] + BINDING) + UPPER * (velocity[i] >= bounds.hi[i] - BINDING)
    for k in range(len(least)):
        sides[n + k] = rows[k] @ velocity <= least[k] + DAMPER_BINDING
    return sides

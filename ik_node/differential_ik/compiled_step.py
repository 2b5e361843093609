"""The control step in compiled code: decomposition, closed form, bounds and the optimum under limits, with a status.

:func:`solve_step` serves nearly every control step in one call. Where a singularity has to be regulated its
status is ``SINGULAR``, and the decomposition is that of the regulation; the regulated task is solved by
:func:`solve_limited`, as is every other one. What ``solve_limited`` does not solve is left to the iterative solvers of
:mod:`ik_node.differential_ik.constrained`: velocity dampers that zero velocity violates, and boxes or bands that permit
no multiple of the twist.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.differential_ik.active_set import largest_motion
from ik_node.differential_ik.closed_form import closed_form
from ik_node.differential_ik.exact_program import BINDING, DAMPER_BINDING, ROUNDING, solve_exactly, task_line, unit_rows
from ik_node.differential_ik.viable_bounds import viable_bounds
from ik_node.differential_ik.viable_scale import Prediction, needs_foresight, viable_scale
from ik_node.jit import compiled
from ik_node.math.pseudoinverse import EPSILON, Decomposition, svd_with_rank
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, nothing_relaxed

LOWER, UPPER, POSITION = 1, 2, 4
NO_ORDER = np.zeros(0, dtype=np.int64)

FREE, LIMITED, DAMPERS, OFF_LINE, SINGULAR, RELAXED = 0, 1, 2, 3, 4, 5
"""Status: no constraint is active; some are; zero velocity violates the dampers; no multiple of the twist is permitted;
a singular value is below the threshold; the limits of this control step contradict each other."""
NO_BANDS = np.zeros((0, 0))
NO_BORDERS = np.zeros(0)


class LimitedSolution(NamedTuple):
    """The optimum under limits; the other fields have a meaning only for ``FREE`` and ``LIMITED``."""

    status: int
    joint_velocity: Array
    """(n,), rad/s (m/s)."""
    task_scale: float
    """s: the fraction of the twist that is executed."""
    base_velocity: Array
    """qd_0, (n,)."""
    base_scale: float
    """s_0."""
    sides: NDArray[np.int8]
    """Active constraints: LOWER, UPPER, their sum or 0 for each joint, plus POSITION for a bound of
    :mod:`~ik_node.differential_ik.viable_bounds`, then 1 or 0 for each damper, (n + k,)."""


class StepSolution(NamedTuple):
    """The solution of a control step."""

    status: int
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
    svd: Decomposition
    """Of J with its rows times ``row_scale``; of any status."""
    off_direction: Array
    """J qd - s V, (m,); rounding, because limits permit a multiple of V."""
    sides: NDArray[np.int8]
    """As in :class:`LimitedSolution`."""

    @property
    def is_solved(self) -> bool:
        """True if the solution is the optimum."""
        return self.status <= LIMITED


def stacked_limits(limits: MotionLimits, null_space_cap: Array) -> Array:
    """The arrays of ``limits`` and ``null_space_cap`` (n,) as rows, (5, n).

    One array is passed to compiled code faster than a NamedTuple of arrays.
    """
    return np.stack((*limits[:4], null_space_cap))


@compiled
def solve_step(
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
    band_rows: Array = NO_BANDS,
    band_least: Array = NO_BORDERS,
    order: NDArray[np.int64] = NO_ORDER,
    tolerance: float = 0.0,
) -> StepSolution:
    """The optimum under limits, if no singularity has to be regulated; see the module for the others.

    Args:
        jacobian: J, (m, n), C-contiguous.
        twist: V, (m,), in the frame of J, m/s and rad/s.
        row_scale: D, (m,).
        threshold: Singular value from which no singularity is near, m.
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
        band_rows: Rows of the bands, (b, n): ``band_rows`` qd >= s ``band_least``.
        band_least: v, (b,).
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
    bounds = joint_bounds(limits, q, previous, elapsed_s)
    status = FREE
    if not svd.sigma[-1] >= threshold and not (svd.rank == 0 and len(band_least)):  # rank 0: nothing is exact
        status = SINGULAR
    elif not nothing_relaxed(bounds):
        status = RELAXED
    if status != FREE:
        none = np.zeros(0)
        return StepSolution(status, none, 0.0, 0.0, none, none, svd, none, np.zeros(0, dtype=np.int8))
    free, wish = closed_form(jacobian, twist, weight, gradient, gain, 0.0, row_scale, per_joint[4], svd), 1.0
    sooner = bounds
    if len(order) == n:
        sooner = viable_bounds(bounds, free.task_velocity, svd.vt[svd.rank :], q, previous, limits, elapsed_s)
    if len(order) == n and needs_foresight(free.task_velocity, scaled, svd.sigma[-1], q, limits):
        ahead = Prediction(jacobian, order, row_scale, twist, tolerance, np.ones(m))
        wish = viable_scale(ahead, q, previous, limits)
        if wish < 1.0:
            free = closed_form(jacobian, wish * twist, weight, gradient, gain, 0.0, row_scale, per_joint[4], svd)
    pull = free.gain * gradient if len(gradient) else np.zeros(n)
    found = solve_limited(
        svd,
        row_scale * twist,
        np.abs(twist).max(),
        free.joint_velocity,
        wish,
        sooner.lo,
        sooner.hi,
        rows,
        least,
        band_rows,
        band_least,
        weight,
        pull,
    )
    for i in range(n if found.status == LIMITED else 0):
        at_lower, at_upper = (found.sides[i] & LOWER) > 0, (found.sides[i] & UPPER) > 0
        if (at_lower and sooner.lo[i] > bounds.lo[i]) or (at_upper and sooner.hi[i] < bounds.hi[i]):
            found.sides[i] += POSITION
    off_direction = jacobian @ found.joint_velocity - found.task_scale * twist
    return StepSolution(
        found.status,
        found.joint_velocity,
        found.task_scale,
        wish,
        free.multiplier_task,
        free.multiplier_potential,
        svd,
        off_direction,
        found.sides,
    )


@compiled
def solve_limited(
    svd: Decomposition,
    scaled_twist: Array,
    max_entry: float,
    free: Array,
    wish: float,
    lo: Array,
    hi: Array,
    rows: Array,
    least: Array,
    band_rows: Array,
    band_least: Array,
    weight: Array,
    pull: Array,
) -> LimitedSolution:
    """The problem of :mod:`ik_node.differential_ik.constrained`, as far as no iterative solver is needed.

    Args:
        svd: Decomposition of D J.
        scaled_twist: D V_f, (m,).
        max_entry: Largest absolute entry of V_f.
        free: The closed form for ``wish`` V_f, (n,).
        wish: The scale s that is approached, 0 to 1.
        lo: Lower ends of the box, (n,), rad/s (m/s).
        hi: Upper ends, (n,).
        rows: Velocity dampers ``rows`` qd >= ``least``, (k, n).
        least: (k,).
        band_rows: Rows of the bands, (b, n): ``band_rows`` qd >= s ``band_least``.
        band_least: v, (b,).
        weight: W, (n, n), or :data:`ik_node.differential_ik.closed_form.IDENTITY`.
        pull: Linear term of the cost, (n,).
    """
    base, none = np.minimum(np.maximum(0.0, lo), hi), np.zeros(len(lo) + len(least), dtype=np.int8)
    if obeys(free, lo, hi, rows, least) and hold(free, wish, band_rows, band_least):
        return LimitedSolution(FREE, free, wish, np.zeros(len(lo)), 0.0, none)
    units, limit = unit_rows(rows, least)
    line = task_line(svd, scaled_twist, max_entry)
    if len(band_least) or len(line.null) > 1:
        scale, velocity = largest_motion(svd, line.ray, free, wish, lo, hi, rows, least, band_rows, band_least, weight)
        if np.isnan(scale):
            return LimitedSolution(OFF_LINE, free, wish, base, 0.0, none)
        return LimitedSolution(LIMITED, velocity, scale, velocity, scale, active_sides(velocity, lo, hi, units, limit))
    if not obeys(base, lo, hi, rows, least):
        return LimitedSolution(DAMPERS, free, wish, base, 0.0, none)
    base_scale = np.nan if np.any(base != 0.0) else 0.0
    found = solve_exactly(line, lo, hi, units, limit, base, base_scale, weight, pull, free, wish)
    velocity = np.minimum(np.maximum(found.joint_velocity, lo), hi)
    if np.isnan(found.scale) or not np.all(np.isfinite(velocity)):
        return LimitedSolution(OFF_LINE, free, wish, base, base_scale, none)
    sides = active_sides(velocity, lo, hi, units, limit)
    return LimitedSolution(LIMITED, velocity, found.scale, found.base_velocity, found.base_scale, sides)


@compiled
def obeys(velocity: Array, lo: Array, hi: Array, rows: Array, least: Array) -> bool:
    """True if ``velocity`` (n,) is within the box and obeys the velocity dampers."""
    for i in range(len(velocity)):
        if not lo[i] <= velocity[i] <= hi[i]:
            return False
    for k in range(len(least)):  # noqa: SIM110 - numba does not compile all() of a generator
        if not rows[k] @ velocity >= least[k]:
            return False
    return True


@compiled
def hold(velocity: Array, scale: float, rows: Array, least: Array) -> bool:
    """True if ``velocity`` (n,) obeys the bands at the task scale s, up to rounding."""
    for k in range(len(least)):  # noqa: SIM110 - numba does not compile all() of a generator
        if not rows[k] @ velocity >= scale * least[k] - ROUNDING:
            return False
    return True


@compiled
def active_sides(velocity: Array, lo: Array, hi: Array, rows: Array, least: Array) -> NDArray[np.int8]:
    """``sides`` of :class:`LimitedSolution` for joint velocities (n,) and dampers of unit length."""
    n = len(velocity)
    sides = np.zeros(n + len(least), dtype=np.int8)
    for i in range(n):
        sides[i] = LOWER * (velocity[i] <= lo[i] + BINDING) + UPPER * (velocity[i] >= hi[i] - BINDING)
    for k in range(len(least)):
        sides[n + k] = rows[k] @ velocity <= least[k] + DAMPER_BINDING
    return sides

"""Moves a solution of inverse kinematics towards a seed, as far as the tolerance of the task and the limits permit.

Sequential quadratic programming; each step dq solves::

    minimise    |q + dq - seed|^2
    subject to  c - J dq = 0 for exact components, -w <= c - J dq <= w for bands ,   lower <= q + dq <= upper
                |dq_i| <= radius

where c are the components of the deviation from the target and w the half-widths (:mod:`ik_node.math.task_error`). The
radius is halved after a step that does not reduce the exact penalty function, and that step is not made.
"""

from __future__ import annotations

import daqp
import numpy as np

from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.screw_chain import KinematicChain

MAX_STEP = 0.3
"""Largest radius, rad (m)."""
MAX_STEPS = 20
"""Maximum number of quadratic programs."""
SMALLEST_STEP = 1e-5
"""Length of a step, rad (m), at which the search ends."""
SOLVED = 1
"""DAQP's exit flag of an optimal solution."""


def moved_towards(
    seed: Array, q: Array, chain: KinematicChain, pose_sd: Array, tolerance: TaskTolerance
) -> list[Array]:
    """Positions from a solution towards the seed.

    Args:
        seed: Joint positions that are to be approached, (n,), rad (m).
        q: A solution of the task within the limits, (n,).
        chain: The arm.
        pose_sd: T_sd, (4, 4), C-contiguous.
        tolerance: Which part of the pose matters.

    Returns:
        Positions (n,) of the steps, the start first; the task holds at the last one to second order in its step.
    """
    form = tolerance.form
    counts = ~tolerance.free
    widths = form.half_widths[counts]
    lower, upper = chain.limits.lower, chain.limits.upper

    def linearised(position: Array) -> tuple[Array, Array]:
        pose, jacobian = chain.evaluate(position)
        deviation = task_deviation(form, pose, pose_sd)
        return deviation.components[counts], np.ascontiguousarray((deviation.rows_b @ jacobian)[counts])

    q = nearest_turns(q, seed, chain)
    path, radius, penalty = [q], MAX_STEP, 0.0
    components, rows = linearised(q)
    for _ in range(MAX_STEPS):
        high = np.concatenate((np.clip(upper - q, 0.0, radius), components + widths))
        low = np.concatenate((np.clip(lower - q, -radius, 0.0), components - widths))
        step, _, flag, result = daqp.solve(np.eye(chain.n), q - seed, rows, high, low)
        if flag != SOLVED or not np.isfinite(step).all():
            break
        following = q + step
        following_components, following_rows = linearised(following)
        penalty = max(penalty, 1.5 * float(np.abs(result["lam"][chain.n :]).max(initial=0.0)))
        before = _merit(q - seed, components, widths, penalty)
        if _merit(following - seed, following_components, widths, penalty) > before:
            radius = 0.5 * min(radius, float(np.abs(step).max()))
        else:
            q, components, rows = following, following_components, following_rows
            path.append(q)
            radius = min(2.0 * radius, MAX_STEP)
        if float(np.abs(step).max()) < SMALLEST_STEP or radius < SMALLEST_STEP:
            break
    return path


def _merit(motion: Array, components: Array, widths: Array, penalty: float) -> float:
    """Cost of a position: half the squared motion, and what exceeds the half-widths times a penalty."""
    outside = np.maximum(np.abs(components) - widths, 0.0)
    return 0.5 * float(motion @ motion) + penalty * float(outside.sum())


def nearest_turns(q: Array, seed: Array, chain: KinematicChain) -> Array:
    """``q`` (n,) shifted by full turns of revolute joints to be nearest to ``seed`` (n,) within the limits."""
    shifted = q + 2.0 * np.pi * np.round((seed - q) / (2.0 * np.pi))
    possible = chain.turning & (shifted >= chain.limits.lower) & (shifted <= chain.limits.upper)
    return np.where(possible, shifted, q)

"""Gradual change of the twist: V_f changes no faster than the joints can follow along it.

A moving arm cannot execute every twist in the next control step, at whatever scale: if V turns or reverses, joints have
to decelerate first. The joint velocities nearest to the direction of V would then move the tool along neither the
present twist nor V. Instead V_f passes through the twists between both ::

    s V_f = alpha J qd_prev + beta V ,     s = alpha + beta <= 1,  alpha as small, then beta as large as possible,

so that the tool first decelerates along its present twist and turns within the plane of both.
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik.constrained import ConstrainedSolution
from ik_node.differential_ik.exact_program import BINDING, task_line
from ik_node.differential_ik.quadratic_program import PRIMAL_TOLERANCE, SOLVED, UNLIMITED
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.task_problem import TaskProblem
from ik_node.differential_ik.viable_bounds import viable_bounds
from ik_node.math.pseudoinverse import Decomposition
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds, MotionLimits

MIN_SCALE = 1e-9
"""A smaller scale is a stop, which every V_f describes."""


class GradualTwist(NamedTuple):
    """The twist between the present one and the desired one that the joints can follow."""

    twist: Array
    """V_f, (6,): between the present twist and V."""
    scale: float
    """s = alpha + beta."""
    present_share: float
    """alpha / s."""


class GradualSolution(NamedTuple):
    """The optimum for V_f."""

    limited: ConstrainedSolution
    bounds: JointBounds
    """The limits of the solution."""
    deferred: Array
    """V - V_f, (m,), in the frame of J."""
    present_share: float
    """alpha / s; 0 if V_f = V."""
    share_aside: float
    """The part of ``present_share`` whose twist is not along V."""


def solve_gradually(
    problem: TaskProblem,
    jacobian: Array,
    twist: Array,
    wish: float,
    moving: ArmState | None,
    limits: MotionLimits,
    bounds: JointBounds,
    dampers: VelocityDampers | None,
) -> GradualSolution:
    """The optimum under limits for V, or for the V_f that the joints can follow if the limits permit no multiple of V.

    Args:
        problem: Task, cost and decomposition of J.
        jacobian: J, (m, n).
        twist: V, (m,), in the frame of J.
        wish: Largest s.
        moving: State of the arm; None for no foresight: V_f changes at once.
        limits: Limits of the joints.
        bounds: Limits of this control step.
        dampers: Velocity dampers.
    """
    if moving is not None:
        line = task_line(problem.svd, problem.row_scale * twist, float(np.abs(twist).max()))
        sooner = viable_bounds(bounds, line.ray, line.null, moving.q, moving.previous, limits, moving.elapsed_s)
        limited = problem.solve(twist, wish, sooner, dampers)
        if not limited.leaves_direction(twist):
            return GradualSolution(limited, sooner, np.zeros(len(twist)), 0.0, 0.0)
    limited, change = problem.solve(twist, wish, bounds, dampers), None
    if moving is not None and limited.leaves_direction(twist):
        change = gradual_twist(problem.svd, jacobian, twist, problem.row_scale, wish, moving.previous, bounds)
    if change is None or moving is None:
        return GradualSolution(limited, bounds, np.zeros(len(twist)), 0.0, 0.0)
    limited = problem.solve(change.twist, change.scale, bounds, dampers)
    wanted, present = problem.row_scale * twist, problem.row_scale * (jacobian @ moving.previous)
    along = min(max(float(wanted @ present) / max(float(wanted @ wanted), MIN_SCALE**2), 0.0), 1.0)
    share = change.present_share
    return GradualSolution(limited, bounds, twist - change.twist, share, share * (1.0 - along))


def gradual_twist(
    svd: Decomposition,
    jacobian: Array,
    twist: Array,
    row_scale: Array,
    wish: float,
    previous: Array,
    bounds: JointBounds,
) -> GradualTwist | None:
    """The twist nearest to V, on the way from the present one, that the joints can execute in this control step.

    Args:
        svd: Decomposition of J with its rows times ``row_scale``.
        jacobian: J, (6, n).
        twist: V, (6,), in the frame of J.
        row_scale: Factors of the rows of J, (6,).
        wish: Largest beta.
        previous: The present command, (n,), rad/s (m/s).
        bounds: Limits of this control step.

    Returns:
        None if the program has no solution.
    """
    line = task_line(svd, row_scale * twist, float(np.abs(twist).max()))
    box = np.column_stack((previous, line.ray, line.null.T))
    found = _least_of_the_present(box, bounds.lo, bounds.hi, wish)
    if found is None:
        # What position limits force is no change of the twist.
        lo = np.minimum(np.maximum(bounds.reach_lo, -bounds.velocity), previous)
        hi = np.maximum(np.minimum(bounds.reach_hi, bounds.velocity), previous)
        found = _least_of_the_present(box, lo, hi, wish)
    if found is None:
        return None
    alpha, beta = found
    scale = min(alpha + beta, 1.0)
    if scale < MIN_SCALE:
        return GradualTwist(twist, 0.0, 0.0)
    share = alpha / (alpha + beta)
    return GradualTwist(share * (jacobian @ previous) + (1.0 - share) * twist, scale, share)


def _least_of_the_present(box: Array, lo: Array, hi: Array, wish: float) -> tuple[float, float] | None:
    """The least alpha, then the largest beta, with ``lo`` <= ``box`` (alpha, beta, z) <= ``hi``."""
    size = box.shape[1]
    matrix = np.concatenate((np.eye(1, size), np.eye(1, size) + np.eye(1, size, 1), box))
    first, last = np.concatenate(([0.0, 0.0], lo)), np.concatenate(([1.0, 1.0], hi))
    least = _optimum(np.eye(1, size)[0], matrix, first, last, wish)
    if least is None:
        return None
    last[0] = min(least[0] + BINDING, 1.0)
    best = _optimum(-np.eye(1, size, 1)[0], matrix, first, last, wish)
    alpha, beta = (least if best is None else best)[:2].tolist()
    return max(alpha, 0.0), max(beta, 0.0)


def _optimum(goal: Array, matrix: Array, first: Array, last: Array, wish: float) -> Array | None:
    """The unknowns of least ``goal``, with first <= matrix x <= last and 0 <= x[1] <= wish."""
    size = matrix.shape[1]
    lower, upper = np.full(size, -UNLIMITED), np.full(size, UNLIMITED)
    lower[:2], upper[:2] = 0.0, (1.0, wish)
    point, _, flag, _ = daqp.solve(
        None,
        goal,
        np.ascontiguousarray(matrix),
        np.minimum(np.concatenate((upper, last)), UNLIMITED),
        np.maximum(np.concatenate((lower, first)), -UNLIMITED),
        primal_tol=PRIMAL_TOLERANCE,
    )
    return np.asarray(point) if flag == SOLVED and np.isfinite(point).all() else None

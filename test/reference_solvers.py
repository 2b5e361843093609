"""Reference solutions of the constrained problem by independent solvers: a linear program for s (scipy's HiGHS), an
equality-constrained minimum on the active bounds, the signs of its multipliers, and DAQP on the whole problem where no
bound is active. They share no code with the package."""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from arms import random_position
from scipy.optimize import linprog, lsq_linear

from ik_node.differential_ik import constrained
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings

ROBOTS = ("panda", "ur5", "ur10", "talos_arm", "xarm7", "kinova")
METHODS = ("plain", "inertia_weighted", "obstacle_gradient", "gravity_gradient", "joint_weighted")
PERIOD_S = 0.002


class Problem(NamedTuple):
    """One state, one twist, one box."""

    jacobian: Array
    twist: Array
    lo: Array
    hi: Array
    weight: Array | None
    gradient: Array | None
    gain: float


class Check(NamedTuple):
    """Result of one problem; differences are the package's value minus the reference's."""

    binds: bool
    scale: float
    trespass: float
    """Largest amount by which a bound is exceeded, rad/s."""
    residual: float
    """Largest entry of J qd - J qd_0 - (s - s_0) V."""
    scale_difference: float
    """NaN where scipy found no solution."""
    deviation_difference: float
    """Difference of \\|J qd - s V\\|, the deviation of the tool motion from V, divided by 1 + \\|V\\|."""
    cost_difference: float
    """Relative to 1 + the reference's |cost|."""
    multiplier_error: float
    """Violation of the stationarity condition with multipliers of the right sign; 0 at the optimum."""
    closed_form_difference: float
    """Largest entry of closed form minus DAQP, rad/s; NaN where a bound is active."""


def problem(robot: Robot, method: str, rng: np.random.Generator) -> Problem:
    """Draw a random position, at rest or moving, sometimes near a position limit, and a small to very large twist."""
    limits = motion_limits(robot, LimitSettings(), 1.0 / PERIOD_S)
    q = random_position(robot, rng)
    close = rng.uniform(size=robot.n) < 0.05
    q[close & np.isfinite(limits.upper)] = limits.upper[close & np.isfinite(limits.upper)] - 1e-3
    moving = rng.choice([0.0, 0.1, 1.0]) * rng.uniform(-1.0, 1.0, robot.n) * limits.velocity
    bounds = joint_bounds(limits, q, moving, PERIOD_S * rng.choice([0.2, 1.0, 5.0]))
    jacobian = robot.evaluate(q).jacobian_b
    if rng.uniform() < 0.5:
        twist = rng.normal(size=6) * 10.0 ** rng.uniform(-3.0, 1.0)
    else:
        twist = jacobian @ rng.uniform(bounds.lo, bounds.hi) * rng.choice([0.5, 1.0, 1.5])
    weight = gradient = None
    gain = 0.0
    if method == "joint_weighted":
        weight = np.diag(10.0 ** rng.uniform(-1.0, 1.0, robot.n))
    elif method != "plain":
        dynamics = robot.dynamics(q)
        weight = dynamics.mass_matrix
        if method == "gravity_gradient":
            gradient, gain = dynamics.gravity, 0.01
        elif method == "obstacle_gradient":
            gradient, gain = rng.normal(size=robot.n), 0.1
    return Problem(jacobian, twist, bounds.lo, bounds.hi, weight, gradient, gain)


def check(task: Problem) -> Check:
    """Solve ``task`` and compare with the references."""
    answer = constrained.solve(task.jacobian, task.twist, task.lo, task.hi, task.weight, task.gradient, task.gain)
    qd, base = answer.joint_velocity, answer.base_velocity
    goal = task.jacobian @ base + (answer.task_scale - answer.base_scale) * task.twist
    astray = task.jacobian @ base - answer.base_scale * task.twist
    weight = np.eye(len(qd)) if task.weight is None else task.weight
    pull = np.zeros(len(qd)) if task.gradient is None else task.gain * task.gradient
    return Check(
        answer.binds,
        answer.task_scale,
        float(np.maximum(qd - task.hi, task.lo - qd).max()),
        float(np.abs(task.jacobian @ qd - goal).max()),
        answer.task_scale - largest_scale(task, astray),
        (float(np.linalg.norm(task.jacobian @ qd - answer.task_scale * task.twist)) - least_deviation(task))
        / (1.0 + float(np.linalg.norm(task.twist))),
        cost_difference(task, answer, weight, pull, goal),
        multiplier_error(task, qd, weight, pull),
        np.nan if answer.binds else float(np.abs(qd - whole_program(task, weight, pull)).max()),
    )


def least_deviation(task: Problem) -> float:
    """Smallest \\|J qd - s V\\| by scipy's bounded least squares in (qd, s)."""
    lower, upper = np.append(task.lo, 0.0), np.append(task.hi, 1.0)
    # scipy does not accept a box of zero width in one direction.
    upper = np.where(upper > lower, upper, lower + 1e-15)
    matrix = np.column_stack((task.jacobian, -task.twist))
    goal = np.zeros(len(task.twist))
    # Either of scipy's two methods may stop before the optimum.
    found = [lsq_linear(matrix, goal, (lower, upper), method=method, tol=1e-14) for method in ("bvls", "trf")]
    return min(float(np.linalg.norm(matrix @ np.clip(answer.x, lower, upper))) for answer in found)


def largest_scale(task: Problem, astray: Array) -> float:
    """Largest s by scipy's linear program in (qd, s), J qd = ``astray`` + s V; NaN where it finds none.

    The rows of the equality are made orthonormal first (J' = Q R), because the solver's tolerances are absolute.
    """
    n = task.jacobian.shape[1]
    goal = np.zeros(n + 1)
    goal[n] = -1.0
    q, r = np.linalg.qr(task.jacobian.T)
    orthonormal = np.column_stack((q.T, -np.linalg.solve(r.T, task.twist))), np.linalg.solve(r.T, astray)
    plain = np.column_stack((task.jacobian, -task.twist)), astray
    box = [*zip(task.lo.tolist(), task.hi.tolist(), strict=True), (0.0, 1.0)]
    for tolerance in (1e-10, 1e-9, 1e-8):
        options = {"primal_feasibility_tolerance": tolerance, "dual_feasibility_tolerance": tolerance}
        for matrix, right in (orthonormal, plain):
            found = linprog(goal, A_eq=matrix, b_eq=right, bounds=box, method="highs", options=options)
            if found.status == 0:
                return float(found.x[n])
    return float("nan")


def cost_difference(
    task: Problem, answer: constrained.ConstrainedSolution, weight: Array, pull: Array, goal: Array
) -> float:
    """Cost minus the least cost with the same J qd and the same joints at their bounds, relative."""
    qd, fixed = answer.joint_velocity, answer.sides[: len(answer.joint_velocity)] > 0
    loose, other = np.flatnonzero(~fixed), qd.copy()
    if len(loose):
        columns = task.jacobian[:, loose]
        rest = goal - task.jacobian[:, fixed] @ qd[fixed]
        u, sigma, vt = np.linalg.svd(columns)
        rank = int(np.count_nonzero(sigma > 1e-9 * max(sigma[0], 1e-3)))
        particular = vt[:rank].T @ ((u[:, :rank].T @ rest) / sigma[:rank])
        null = vt[rank:]
        if len(null):
            inner = weight[np.ix_(loose, loose)]
            slope = inner @ particular + weight[np.ix_(loose, np.flatnonzero(fixed))] @ qd[fixed] + pull[loose]
            particular = particular - null.T @ np.linalg.solve(null @ inner @ null.T, null @ slope)
        other[loose] = particular

    def cost(x: Array) -> float:
        return float(0.5 * x @ weight @ x + pull @ x)

    return (cost(qd) - cost(other)) / (1.0 + abs(cost(other)))


def multiplier_error(task: Problem, qd: Array, weight: Array, pull: Array) -> float:
    """Distance of W qd + k grad_h from J' lambda + mu, with mu >= 0 at lower bounds and <= 0 at upper bounds."""
    slope = weight @ qd + pull
    eye = np.eye(len(qd))
    low, high = eye[qd <= task.lo + 1e-10], -eye[qd >= task.hi - 1e-10]
    columns = np.concatenate((task.jacobian, low, high)).T
    least = np.concatenate((np.full(len(task.jacobian), -np.inf), np.zeros(len(low) + len(high))))
    found = lsq_linear(columns, slope, bounds=(least, np.inf), method="bvls", tol=1e-14, max_iter=1000)
    return float(np.abs(columns @ found.x - slope).max() / max(1.0, np.abs(slope).max()))


def whole_program(task: Problem, weight: Array, pull: Array) -> Array:
    """Solve the unmodified problem with DAQP: W, J qd = V, the box."""
    m, n = task.jacobian.shape
    upper, lower = np.concatenate((task.hi, task.twist)), np.concatenate((task.lo, task.twist))
    sense = np.concatenate((np.zeros(n, dtype=np.int32), np.full(m, 5, dtype=np.int32)))
    jacobian = np.ascontiguousarray(task.jacobian)
    qd, _, flag, _ = daqp.solve(np.ascontiguousarray(weight), pull, jacobian, upper, lower, sense, primal_tol=1e-10)
    return np.asarray(qd) if flag == 1 else np.full(n, np.nan)

"""The reduced problem of a task with a tolerance: the optimum of random states by independent solvers.

The rows are made by ``task_deviation``; s is checked by a linear program (HiGHS), the joint velocity by the optimality
conditions and by DAQP on the whole problem. None of it shares code with the package.
"""

from __future__ import annotations

from math import inf
from typing import NamedTuple

import daqp
import numpy as np
import pytest
from arms import random_position
from independent_kinematics import Kinematics
from loop import READY, make_robot
from random_states import cases
from scipy.optimize import linprog, lsq_linear

from ik_node.differential_ik import constrained
from ik_node.differential_ik.compiled_step import StepSolution, solve_step, stacked_limits
from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.differential_ik.task_rows import BandBorders, TaskBands, ToleranceRows
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.twist_account import twist_account
from ik_node.math import se3
from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, joint_bounds, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings, Settings

ROBOTS = ("panda", "ur5", "ur10", "talos_arm", "xarm7", "z1")
TASKS = {
    "pointing": TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf)),
    "yaw of the base free": TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf), "base"),
    "position": TaskTolerance((0.0, 0.0, 0.0, inf, inf, inf)),
    "position and bands": TaskTolerance((0.0, 0.0, 0.0, 0.2, 0.2, 0.2)),
    "a band beside a free axis": TaskTolerance((0.0, 0.0, 0.01, 0.0, 0.1, inf)),
    "bands": TaskTolerance((0.01, 0.01, 0.01, 0.1, 0.1, 0.1)),
}
PERIOD_S, HELD_S = 0.002, 0.01
ROW_SCALE = np.repeat((1.0, 0.3), 3)


class Problem(NamedTuple):
    """J_t qd = s V, r qd >= s v, lo <= qd <= hi, least 1/2 qd' W qd + g' qd."""

    jacobian: Array
    twist: Array
    bands: TaskBands | None
    lo: Array
    hi: Array
    weight: Array
    pull: Array
    row_scale: Array
    limits: MotionLimits
    q: Array
    previous: Array
    """Of these, lo and hi follow."""


def problem(
    robot: Robot, kinematics: Kinematics, task: TaskTolerance, method: str, rng: np.random.Generator
) -> Problem:
    limits = motion_limits(robot, LimitSettings(), 1.0 / PERIOD_S)
    q = random_position(robot, rng)
    moving = rng.choice([0.0, 0.05]) * rng.uniform(-1.0, 1.0, robot.n)
    bounds = joint_bounds(limits, q, moving, HELD_S)
    pose = robot.pose(q)
    target = pose @ se3.exp(rng.normal(size=6) * rng.choice([0.0, 0.05, 0.5]))
    rows = task_deviation(task.form, pose, np.ascontiguousarray(target)).rows_b @ kinematics.jacobian(q)
    exact, banded = np.flatnonzero(task.exact), np.flatnonzero(~task.exact & ~task.free)
    jacobian = rows[exact] if len(exact) else np.zeros((1, robot.n))
    twist = rng.normal(size=len(jacobian)) * 10.0 ** rng.uniform(-3.0, 1.0) * (len(exact) > 0)
    bands = None
    if len(banded):
        both = np.concatenate((rows[banded], -rows[banded]))
        upper = rng.choice([-1.0, -0.05, 0.0, 0.05], len(banded)) * rng.uniform(0.0, 1.0, len(banded))
        lower = np.minimum(-upper, -rng.uniform(0.0, 0.5, len(banded)))
        bands = TaskBands(both, np.concatenate((upper, lower)), ("band",) * len(both))
    weight, gradient, gain = np.eye(robot.n), np.zeros(robot.n), 0.0
    if method == "joint_weighted":
        weight = np.diag(10.0 ** rng.uniform(-1.0, 1.0, robot.n))
    elif method != "plain":
        dynamics = robot.dynamics(q)
        weight = dynamics.mass_matrix
        if method == "gravity_gradient":
            gradient, gain = dynamics.gravity, 0.01
        elif method == "obstacle_gradient":
            gradient, gain = rng.normal(size=robot.n), 0.1
    return Problem(
        jacobian,
        twist,
        bands,
        bounds.lo,
        bounds.hi,
        weight,
        gain * gradient,
        ROW_SCALE[exact] if len(exact) else np.ones(1),
        limits,
        q,
        moving,
    )


def answer_of_one_pass(p: Problem) -> StepSolution:
    rows, least = inequalities(p)
    return solve_step(
        np.ascontiguousarray(p.jacobian),
        p.twist,
        p.row_scale,
        1e-3,
        p.weight,
        p.pull,
        1.0,
        stacked_limits(p.limits, np.full(len(p.lo), np.inf)),
        p.limits.dt_max_s,
        p.limits.recovery_speed,
        p.q,
        p.previous,
        HELD_S,
        np.zeros((0, len(p.lo))),
        np.zeros(0),
        rows,
        least,
    )


def answer(p: Problem) -> constrained.ConstrainedSolution:
    return constrained.solve(
        p.jacobian, p.twist, p.lo, p.hi, p.weight, p.pull, 1.0, row_scale=p.row_scale, bands=p.bands
    )


def inequalities(p: Problem) -> tuple[Array, Array]:
    """Rows (k, n) and v (k,) of the bands."""
    return (np.zeros((0, len(p.lo))), np.zeros(0)) if p.bands is None else p.bands[:2]


def largest_scale(p: Problem) -> tuple[float, float]:
    """The largest s by HiGHS, and by how much its answer exceeds the rows; NaN where it finds none."""
    rows, least = inequalities(p)
    q, r = np.linalg.qr(p.jacobian.T) if p.jacobian.any() else (np.zeros((len(p.lo), 1)), np.eye(1))
    equal = np.column_stack((q.T, -np.linalg.solve(r.T, p.twist)))
    goal = np.append(np.zeros(len(p.lo)), -1.0)
    box = [*zip(p.lo.tolist(), p.hi.tolist(), strict=True), (0.0, 1.0)]
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    inequality = {"A_ub": np.column_stack((-rows, least)), "b_ub": np.zeros(len(least))} if len(least) else {}
    found = linprog(
        goal, A_eq=equal, b_eq=np.zeros(len(equal)), bounds=box, method="highs", options=options, **inequality
    )
    if found.status != 0:
        return float("nan"), 0.0
    qd, s = found.x[:-1], float(found.x[-1])
    excess = [np.abs(p.jacobian @ qd - s * p.twist), s * least - rows @ qd, p.lo - qd, qd - p.hi]
    return s, float(np.concatenate(excess).max())


def optimality_error(p: Problem, qd: Array, s: float) -> tuple[float, float]:
    """Distance of W qd + g from J' lambda + r' mu + box multipliers of the right signs, relative; the largest one."""
    rows, least = inequalities(p)
    active = rows[rows @ qd <= s * least + 1e-9]
    eye = np.eye(len(qd))
    low, high = eye[qd <= p.lo + 1e-10], -eye[qd >= p.hi - 1e-10]
    columns = np.concatenate((p.jacobian, active, low, high)).T
    free = len(p.jacobian)
    ends = np.concatenate((np.full(free, -np.inf), np.zeros(columns.shape[1] - free)))
    slope = p.weight @ qd + p.pull
    found = lsq_linear(columns, slope, bounds=(ends, np.inf), method="bvls", tol=1e-14, max_iter=1000)
    error = float(np.abs(columns @ found.x - slope).max() / max(1.0, np.abs(slope).max()))
    return error, float(np.abs(found.x).max())


def least_cost(p: Problem, s: float) -> float:
    """The least cost at s by DAQP on the whole problem; NaN where it finds none, as where s leaves one point only."""
    rows, least = inequalities(p)
    matrix = np.ascontiguousarray(np.concatenate((p.jacobian, rows)))
    upper = np.concatenate((p.hi, s * p.twist, np.full(len(least), 1e30)))
    lower = np.concatenate((p.lo, s * p.twist, s * least))
    qd, _, flag, _ = daqp.solve(p.weight, p.pull, matrix, upper, lower, primal_tol=1e-11)
    return cost(p, qd) if flag == 1 else float("nan")


def cost(p: Problem, qd: Array) -> float:
    return float(0.5 * qd @ p.weight @ qd + p.pull @ qd)


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ROBOTS)
def test_the_answer_to_the_reduced_problem_is_its_optimum(name: str, task: str) -> None:
    """Each method; limits and bands bind in a part of the states."""
    check_optimum(name, task, 6, 1)


@pytest.mark.exhaustive
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ROBOTS)
def test_the_answers_to_many_reduced_problems_are_optima(name: str, task: str) -> None:
    check_optimum(name, task, 300, 2)


def check_optimum(name: str, task: str, count: int, seed: int) -> None:
    robot = make_robot(name)
    kinematics, rng = Kinematics(robot), np.random.default_rng(seed)
    limited = banded = compared = passed = 0
    for method in METHODS:
        for _ in range(count):
            p = problem(robot, kinematics, TASKS[task], method, rng)
            found = answer(p)
            qd, s = found.joint_velocity, found.task_scale
            rows, least = inequalities(p)
            assert (qd >= p.lo).all()
            assert (qd <= p.hi).all()
            assert np.abs(p.jacobian @ qd - s * p.twist).max() < 1e-8 * max(1.0, np.abs(p.twist).max())
            assert (rows @ qd >= s * least - 1e-9).all()
            one_pass = answer_of_one_pass(p)
            if one_pass.is_solved:
                assert s == pytest.approx(one_pass.task_scale, abs=1e-9)
                assert one_pass.joint_velocity == pytest.approx(qd, abs=1e-9)
            passed += bool(one_pass.is_solved and (rows @ qd <= s * least + 1e-9).any())
            best, excess = largest_scale(p)
            assert np.isnan(best) or s >= best - 1e-9 - 1e3 * max(excess, 0.0)
            error, multiplier = optimality_error(p, qd, s)
            assert error < 1e-9 + 1e-14 * multiplier, "the check itself has this rounding"
            reference = least_cost(p, s)
            if not np.isnan(reference):
                # the reference may exceed its rows by 1e-11, which gains as much as the multipliers say
                assert cost(p, qd) - reference < 1e-9 * (1.0 + abs(reference)) + 1e-10 * multiplier
                compared += 1
            limited += s < 1.0
            banded += bool((rows @ qd <= s * least + 1e-9).any())
    assert compared > 0.2 * count * len(METHODS)
    assert passed > 0 or TASKS[task].free.sum() + TASKS[task].exact.sum() == 6
    assert limited > 0 or TASKS[task].exact.sum() == 0
    assert banded > 0 or TASKS[task].free.sum() + TASKS[task].exact.sum() == 6


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ["ur5", "panda", "xarm7"])
def test_the_account_of_the_followed_rows_has_no_remainder(name: str, task: str) -> None:
    """Whatever limits and singularities do, along the exact rows; and the wrench is zero along what is free.

    All methods; J by an independent computation.
    """
    robot, tolerance = make_robot(name), TASKS[task]
    kinematics = Kinematics(robot)
    for number, method in enumerate(METHODS):
        values = {"method": method, "obstacles.self_collision": False, "task.tolerance": tolerance.half_widths}
        solver = DifferentialIkSolver(robot, Settings().with_values(values))
        rng = np.random.default_rng(number)
        source = cases(robot, kinematics, solver, rng)
        case = next(source)
        for _ in range(60):
            middle = case.state.q_middle
            pose = robot.pose(middle)
            target = np.ascontiguousarray(pose @ se3.exp(rng.normal(size=6) * 0.05))
            deviation = task_deviation(tolerance.form, pose, target)
            banded = np.flatnonzero(~tolerance.exact & ~tolerance.free)
            borders = BandBorders(banded, np.full(len(banded), 10.0), np.ones(len(banded)), np.full(robot.n, 10.0))
            rows = ToleranceRows(robot, ROW_SCALE, tolerance.form, borders)
            rows.aim(Motion(target, rng.normal(size=6) * rng.choice([0.0, 0.1])))
            solution = solver.solve_twist(case.state, case.twist, rows)
            followed = deviation.rows_b[tolerance.exact]
            twist = followed @ case.twist
            account = twist_account(case.twist, solution.truncated_b, solution.off_direction_b, solution.task_scale)
            done = followed @ kinematics.jacobian(middle) @ solution.joint_velocity
            parts = followed @ (account.held_back + account.truncated - account.off_direction)
            assert np.abs(twist - done - parts).max(initial=0.0) < 1e-9
            free_motions = np.linalg.inv(deviation.rows_b)[:, ~tolerance.exact]
            for wrench in (solution.multiplier_task, solution.multiplier_potential):
                assert np.abs(wrench @ free_motions).max(initial=0.0) < 1e-9 * (1.0 + np.abs(wrench).max())
            case = source.send(solution.joint_velocity)


def resting(robot: Robot, q: Array) -> ArmState:
    return ArmState(q, q, np.zeros(robot.n), PERIOD_S, 0)


def test_a_singularity_of_rows_that_are_not_followed_is_none() -> None:
    """At the wrist singularity of a UR5 position alone is followed at full speed; the whole pose is not."""
    robot = make_robot("ur5")
    q = np.array(READY["ur5"])
    q[4] = 0.0
    solver = DifferentialIkSolver(robot, Settings().with_values({"limits.acceleration": (1000.0,)}))
    pose, twist = robot.pose(q), np.array((0.05, 0.02, 0.0, 0.1, 0.1, 0.1))
    whole = solver.solve_twist(resting(robot, q), twist)
    assert whole.singular_values[-1] < 1e-3
    solver.reset()
    task = TaskTolerance((0.0, 0.0, 0.0, inf, inf, inf))
    rows = ToleranceRows(robot, ROW_SCALE, task.form)
    rows.aim(Motion(pose, np.zeros(6)))
    solution = solver.solve_twist(resting(robot, q), twist, rows)
    assert solution.task_scale == 1.0
    assert solution.singularity_scale == 1.0
    assert not solution.truncated_b.any()
    assert np.nanmin(solution.singular_values) > 0.12
    assert np.count_nonzero(np.isnan(solution.singular_values)) == 3
    done = robot.evaluate(q).jacobian_b[:3] @ solution.joint_velocity
    assert np.abs(done - twist[:3]).max() < 1e-9

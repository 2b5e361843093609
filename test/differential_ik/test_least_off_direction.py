"""Direction first: off the direction of V_f by the least that the bounds of a control step permit, then the greatest s.

The references are a bounded least squares solver and a linear program of SciPy, with J by Pinocchio.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from independent_kinematics import Kinematics
from loop import make_robot
from random_states import Case, cases, solve
from scipy.optimize import linprog, lsq_linear

from ik_node.differential_ik.bounded_least_squares import bounded_least_squares
from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.solution import DifferentialIkSolution
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds
from ik_node.settings.groups import Settings

ROBOTS = ("ur5", "ur10", "panda", "xarm7", "z1", "talos_arm")
ROW_SCALE = np.repeat((1.0, 0.3), 3)
ACCURACY = 1e-6
"""m/s."""
LINEAR_PROGRAM_ACCURACY = 1e-5
"""Of s; that of the reference, which meets equations to 1e-7."""
WELL_CONDITIONED = 0.05
"""Least singular value at which the linear program is a reference, m."""


class Reference(NamedTuple):
    """The optimum of one control step by other solvers."""

    off: float
    """Least |D (J qd - s V_f)|, m/s."""
    smallest: float
    """Smallest s at the reported motion off the direction."""
    largest: float


def reference(
    solver: DifferentialIkSolver, jacobian: Array, case: Case, solution: DifferentialIkSolution
) -> Reference | None:
    """The optimum; None if the linear program has no solution within its accuracy."""
    state = case.state
    bounds = joint_bounds(solver.limits, state.q, state.previous, state.elapsed_s)
    ray = ROW_SCALE * (case.twist - solution.truncated_b)
    deviation = np.column_stack((ROW_SCALE[:, None] * jacobian, -ray))
    # The solver requires lo < hi, and joints outside their limits have a single point as the box.
    lo, hi = np.append(bounds.lo, 0.0), np.append(bounds.hi, 1.0)
    hi = np.maximum(hi, lo + 1e-12)
    found = [
        lsq_linear(deviation, np.zeros(6), (lo, hi), method=method, tol=1e-14, max_iter=500)
        for method in ("bvls", "trf")
    ]
    off = min(float(np.sqrt(2.0 * one.cost)) for one in found)
    if solution.singular_values[-1] < WELL_CONDITIONED or np.linalg.norm(ray) < 1e-2:
        return Reference(off, -np.inf, np.inf)
    ends = []
    for sign in (1.0, -1.0):
        goal = np.append(np.zeros(len(bounds.lo)), sign)
        program = linprog(
            goal,
            A_eq=deviation,
            b_eq=ROW_SCALE * solution.off_direction_b,
            bounds=np.column_stack((lo, hi)),
            method="highs",
        )
        if program.status != 0:
            return None
        ends.append(float(program.x[-1]))
    return Reference(off, *ends)


def check(name: str, method: str, count: int, seed: int) -> tuple[int, int]:
    """Compares ``count`` control steps; returns in how many V had no feasible multiple, and how many had the best s."""
    robot = make_robot(name)
    values = {"method": method, "rate_hz": 500.0, "obstacles.self_collision": False}
    solver, kinematics = DifferentialIkSolver(robot, Settings().with_values(values)), Kinematics(robot)
    source = cases(robot, kinematics, solver, np.random.default_rng(seed))
    case, off_steps, scaled_steps = next(source), 0, 0
    while count:
        released = solver.capture().stalled_s > 0.9
        solution = solve(solver, case)
        if case.velocity_wanted is None and not released:
            count -= 1
            best = reference(solver, kinematics.jacobian(case.state.q_middle), case, solution)
            off = float(np.linalg.norm(ROW_SCALE * solution.off_direction_b))
            if best is not None:
                assert off <= best.off + ACCURACY, (name, method, case)
                s, wish = solution.task_scale, solution.singularity_scale
                if s < wish - LINEAR_PROGRAM_ACCURACY:
                    assert s >= best.largest - LINEAR_PROGRAM_ACCURACY or best.largest == np.inf, (name, method, case)
                    scaled_steps += best.largest < np.inf
                elif s > wish + LINEAR_PROGRAM_ACCURACY:
                    assert s <= best.smallest + LINEAR_PROGRAM_ACCURACY or best.smallest == -np.inf, (
                        name,
                        method,
                        case,
                    )
            off_steps += off > ACCURACY
        case = source.send(solution.joint_velocity)
    return off_steps, scaled_steps


@pytest.mark.parametrize("name", ROBOTS)
def test_the_direction_is_kept_as_far_as_the_bounds_permit_and_then_s_is_the_greatest(name: str) -> None:
    """Random states, all methods: the gradient of a method gives way as well."""
    found = np.array([check(name, method, 60, number) for number, method in enumerate(METHODS)])
    assert (found.sum(axis=0) > (40, 10)).all(), found


@pytest.mark.exhaustive
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ROBOTS)
def test_the_direction_is_kept_in_many_states(name: str, method: str) -> None:
    check(name, method, 2000, 77)


def test_bounded_least_squares_agrees_with_scipy() -> None:
    """Well and badly conditioned problems with six to nine unknowns, some at a single point."""
    rng = np.random.default_rng(6)
    for _ in range(300):
        n = int(rng.integers(6, 10))
        u, sigma, rows = np.linalg.svd(rng.normal(size=(6, n)), full_matrices=False)
        sigma[-1] *= 10.0 ** rng.uniform(-8.0, 0.0)
        a = np.concatenate(((u * sigma) @ rows, 1e-7 * np.eye(n)))
        b = np.append(rng.normal(size=6) * rng.choice([0.0, 0.1, 1.0]), np.zeros(n))
        middle, width = rng.normal(size=n), rng.choice([0.0, 0.02, 1.0], size=n)
        lo, hi = middle - width * rng.uniform(size=n), middle + width * rng.uniform(size=n)
        x = bounded_least_squares(a, b, lo, hi, middle)
        assert ((lo <= x) & (x <= hi)).all()
        best = lsq_linear(a, b, (lo, np.maximum(hi, lo + 1e-13)), method="bvls", tol=1e-15, max_iter=500)
        assert np.linalg.norm(a @ x - b) <= np.sqrt(2.0 * best.cost) + 1e-9

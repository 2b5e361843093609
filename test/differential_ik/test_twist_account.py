"""The account of a twist: in every control step V is split without remainder into what is done, held back along V,
truncated near a singularity, and off the direction with the limits that cause it.

J is computed by Pinocchio, not by the solver. A solver keeps its state between the random states, as in a run.
"""

from __future__ import annotations

import numpy as np
import pytest
from independent_kinematics import Kinematics
from loop import make_robot
from random_states import Case, cases, solve

from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.solution import DifferentialIkSolution
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.interfaces.twist_account import twist_account
from ik_node.robot.joint_limits import joint_bounds
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

ROBOTS = ("ur5", "ur10", "panda", "xarm7", "z1", "talos_arm")
MAX_REMAINDER = 1e-9
"""m/s, rad/s."""
ANGULAR_SCALE = 0.3
"""Characteristic length, m: an angular component may be a linear one divided by it."""
MAX_FORCED = 2.0
"""Largest component of V_f that the present motion forces on it beside a singularity, whatever V is: that of 7 joints
at 4.6 rad/s with a singular value of 0.05 m, angular rows divided by 0.3 m, m/s, rad/s."""


def worst_remainder(name: str, method: str, count: int, seed: int) -> tuple[float, dict[str, int]]:
    """The largest component of the remainder over ``count`` states, and in how many each part was not zero."""
    robot = make_robot(name)
    settings = Settings().with_values({"method": method, "rate_hz": 500.0, "obstacles.self_collision": False})
    solver, kinematics = DifferentialIkSolver(robot, settings), Kinematics(robot)
    rng = np.random.default_rng(seed)
    source = cases(robot, kinematics, solver, rng)
    case, worst = next(source), 0.0
    seen = {"held back": 0, "truncated": 0, "off the direction": 0}
    for _ in range(count):
        solution = solve(solver, case)
        command = solution.joint_velocity
        account = twist_account(case.twist, solution.truncated_b, solution.off_direction_b, solution.task_scale)
        done = kinematics.jacobian(case.state.q_middle) @ command
        parts = done + account.held_back + account.truncated - account.off_direction
        remainder = max(float(np.abs(case.twist - parts).max()), float(np.abs(done - account.done).max()))
        worst = max(worst, remainder)
        assert remainder < MAX_REMAINDER, (name, method, case)
        assert 0.0 <= solution.task_scale <= 1.0
        assert np.abs(account.truncated).max() <= 2.0 * np.abs(case.twist).max() / ANGULAR_SCALE + MAX_FORCED
        off = bool(np.abs(account.off_direction).max() > 1e-7)
        truncated = bool(np.abs(account.truncated).max() > 1e-9)
        if off:
            check_limits(robot, solver, case, solution)
        else:
            assert not truncated or solution.singular_values[-1] < settings.singularity.threshold
        seen["held back"] += bool(np.abs(account.held_back).max() > 1e-9)
        seen["truncated"] += truncated
        seen["off the direction"] += off
        case = source.send(command)
    return worst, seen


def check_limits(robot: Robot, solver: DifferentialIkSolver, case: Case, solution: DifferentialIkSolution) -> None:
    """Every named limit binds: the command of its joint is at an end of the box."""
    state, qd = case.state, solution.joint_velocity
    bounds = joint_bounds(solver.limits, state.q, state.previous, state.elapsed_s)
    assert solution.off_direction_limits
    for text in solution.off_direction_limits:
        kind, joint = text.split(" ", 1)
        index = robot.joints.index(joint)
        assert kind in ("velocity", "acceleration", "position")
        assert min(qd[index] - bounds.lo[index], bounds.hi[index] - qd[index]) < 1e-9
        assert any(active.split(" ", 1)[1] == joint for active in solution.binding)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_account_of_random_states_has_no_remainder(name: str) -> None:
    """All methods, twists and joint velocities; each part of the account occurs."""
    total = {"held back": 0, "truncated": 0, "off the direction": 0}
    for number, method in enumerate(METHODS):
        _, seen = worst_remainder(name, method, 250, number)
        total = {part: count + seen[part] for part, count in total.items()}
    assert min(total.values()) > 20, total


@pytest.mark.exhaustive
def test_the_account_of_a_hundred_thousand_states_has_no_remainder() -> None:
    """Prints the worst remainder (pytest -s)."""
    each = 100_000 // (len(ROBOTS) * len(METHODS)) + 1
    arms = [(name, method) for name in ROBOTS for method in METHODS]
    rows = [(*arm, *worst_remainder(*arm, each, 100 + number)) for number, arm in enumerate(arms)]
    for name, method, worst, seen in rows:
        counts = ", ".join(f"{part} in {count}" for part, count in seen.items())
        print(f"{name} {method}: {each} states, worst remainder {worst:.1e}; {counts}")
    print(f"{each * len(rows)} states, worst remainder {max(row[2] for row in rows):.1e} m/s, rad/s")

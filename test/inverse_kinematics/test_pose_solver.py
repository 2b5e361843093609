"""The production solver: reachable poses are solved within limits and tolerance (checked independently), the solution
does not depend on earlier calls, caps hold, and unreachable poses are not reported as solved. `ik_benchmark ik` runs
the full 10,000 poses per robot and measures the times."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ik_node.errors import InputError
from ik_node.inverse_kinematics.newton_raphson import TerminationReason
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import ScrewChain


def robot(name: str) -> Robot:
    arm = catalogue.find(name)
    return Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)


def random_positions(arm: Robot, seed: int, count: int) -> Array:
    low = np.where(np.isfinite(arm.limits.lower), arm.limits.lower, -np.pi)
    high = np.where(np.isfinite(arm.limits.upper), arm.limits.upper, np.pi)
    return np.random.default_rng(seed).uniform(low, high, (count, arm.n))


def errors(reached: Array, wanted: Array) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses, without the logarithm that the solver uses."""
    turn = reached[:3, :3].T @ wanted[:3, :3]
    axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(axis), 0.5 * (np.trace(turn) - 1.0)))
    return float(np.linalg.norm(reached[:3, 3] - wanted[:3, 3])), angle


@pytest.mark.parametrize("name", ["panda", "ur5", "ur10", "ur3", "kinova", "talos_arm", "xarm7", "z1"])
def test_reachable_poses_are_solved_within_limits(name: str) -> None:
    # Forward kinematics by a second Pinocchio model.
    arm = robot(name)
    solver = PoseSolver(arm)
    other = robot(name)
    for q in random_positions(arm, 1, 100):
        wanted = arm.pose(q)
        solution = solver.solve(wanted)
        assert solution.converged, solution.reason
        assert (solution.q >= arm.limits.lower).all()
        assert (solution.q <= arm.limits.upper).all()
        distance, angle = errors(other.pose(solution.q), wanted)
        # The linear part of V_b is not the distance itself, but agrees with it up to the angle between the poses.
        assert distance <= 1.001e-6
        assert angle <= 1.001e-6
        assert solution.iterations <= 3000


@pytest.mark.parametrize("name", ["so100", "anymal", "b1-z1", "double_pendulum", "iris", "tiago", "baxter"])
def test_any_robot_of_example_robot_data(name: str) -> None:
    # Names shared by joints and links, one or two joints, sliding joints, more joints than seven.
    arm = robot(name)
    solver = PoseSolver(arm)
    for q in random_positions(arm, 6, 10):
        solution = solver.solve(arm.pose(q))
        assert solution.converged
        assert max(errors(arm.pose(solution.q), arm.pose(q))) <= 1.001e-6


def test_first_start_is_the_middle_of_the_range_and_the_rest_fill_it() -> None:
    arm = robot("panda")
    solver = PoseSolver(arm)
    middle = 0.5 * (arm.limits.lower + arm.limits.upper)
    np.testing.assert_allclose(solver.start(0), middle, atol=1e-15)
    np.testing.assert_array_equal(solver.solve(arm.pose(middle + 0.1)).iterates[0].theta, solver.start(0))
    parts = np.array([solver.start(index) for index in range(400)])
    parts = (parts - arm.limits.lower) / (arm.limits.upper - arm.limits.lower)
    assert parts.min() >= 0.0
    assert parts.max() <= 1.0
    counts = np.array([np.histogram(column, 10, (0.0, 1.0))[0] for column in parts.T])
    assert (np.abs(counts - 40) <= 8).all()


def test_same_question_same_bits() -> None:
    # Also after other calls, and from another solver.
    arm = robot("panda")
    solver = PoseSolver(arm)
    wanted = arm.pose(random_positions(arm, 2, 1)[0])
    first = solver.solve(wanted)
    for q in random_positions(arm, 3, 5):
        solver.solve(arm.pose(q))
    for again in (solver.solve(wanted), PoseSolver(robot("panda")).solve(wanted)):
        assert np.array_equal(first.q, again.q)
        assert (first.iterations, first.searches) == (again.iterations, again.searches)


def test_seed_comes_first() -> None:
    # At the solution: no step. Beside it: the solution next to the seed, not another branch.
    arm = robot("ur5")
    solver = PoseSolver(arm)
    q = np.array([0.4, -1.1, 1.3, -0.7, 0.9, 0.3])
    assert solver.solve(arm.pose(q), q).iterations == 0
    near = solver.solve(arm.pose(q), q + 0.05)
    assert near.searches == 1
    np.testing.assert_allclose(near.q, q, atol=1e-5)
    outside = solver.solve(arm.pose(q), q + 40.0)
    assert outside.converged
    assert (np.abs(outside.q) <= arm.limits.upper).all()


def test_turns_are_kept_where_limits_permit_them() -> None:
    # A seed two thirds of a turn higher stays there: the caller's difference of joint positions must not jump.
    arm = robot("ur5")
    q = np.array([4.0, -1.1, 1.3, -0.7, -5.0, 0.3])
    np.testing.assert_allclose(PoseSolver(arm).solve(arm.pose(q), q + 0.02).q, q, atol=1e-5)


def test_out_of_reach_is_not_solved_and_costs_no_more_than_the_cap() -> None:
    # The result is the nearest pose found, with the reason.
    arm = robot("ur5")
    goal = np.eye(4)
    goal[:3, 3] = 3.0, 0.0, 0.5
    capped = PoseSolver(arm, max_iterations=200).solve(goal)
    assert not capped.converged
    assert capped.reason in {TerminationReason.STALLED, TerminationReason.CAP}
    assert capped.iterations == 200
    single = PoseSolver(arm).solve(goal, restarts=0)
    assert (single.converged, single.searches) == (False, 1)
    assert single.iterations <= 30
    reached = arm.pose(capped.q)
    assert np.linalg.norm(reached[:3, 3] - goal[:3, 3]) < 3.0
    assert (np.abs(capped.q) <= arm.limits.upper).all()


def test_reachable_only_outside_the_limits_is_not_solved() -> None:
    # The same arm with limits that exclude both elbow configurations of the goal.
    screws = [[0, 0], [2, 1], [0, 0], [0, 0], [0, 0], [1, 1]]
    home = np.eye(4)
    home[0, 3] = 2.0
    free, limited = ScrewChain(home, screws), ScrewChain(home, screws, [-0.4, -0.4], [0.4, 0.4])
    goal = free.pose(np.array([0.5, 1.5]))
    assert PoseSolver(free).solve(goal).converged
    solution = PoseSolver(limited, max_iterations=300).solve(goal)
    assert not solution.converged
    assert (np.abs(solution.q) <= 0.4).all()


def test_solution_at_a_limit_is_found() -> None:
    # Joints at their limits are excluded from a step that would move them further outwards.
    arm = robot("panda")
    for index in range(arm.n):
        q = 0.5 * (arm.limits.lower + arm.limits.upper)
        q[index] = arm.limits.upper[index]
        solution = PoseSolver(arm).solve(arm.pose(q))
        assert solution.converged
        assert (solution.q <= arm.limits.upper).all()


def test_arm_with_fewer_joints_than_the_task() -> None:
    # Five joints, reachable poses: least squares steps.
    full = robot("ur5")
    home, screws = full.evaluate(np.zeros(6))
    chain = ScrewChain(home, screws[:, :5], [-3.0] * 5, [3.0] * 5)
    solver = PoseSolver(chain)
    for q in np.random.default_rng(4).uniform(-2.5, 2.5, (20, 5)):
        solution = solver.solve(chain.pose(q))
        assert solution.converged
        assert max(errors(chain.pose(solution.q), chain.pose(q))) <= 1.001e-6


def test_exactly_singular_target_and_start() -> None:
    # UR5 stretched out: start (all zeros), target, and both.
    arm = robot("ur5")
    solver = PoseSolver(arm)
    for q in (np.zeros(6), np.array([0.3, 0.0, 0.0, 0.4, 0.0, 0.1])):
        solution = solver.solve(arm.pose(q), np.zeros(6))
        assert solution.converged
        assert max(errors(arm.pose(solution.q), arm.pose(q))) <= 1.001e-6


def test_half_turn_goal() -> None:
    # The rotation from the middle of the range to the goal is exactly pi about the tool's axis.
    arm = robot("panda")
    solver = PoseSolver(arm)
    goal = arm.pose(solver.start(0)) @ se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.pi]))
    solution = solver.solve(goal)
    assert solution.converged
    assert max(errors(arm.pose(solution.q), goal)) <= 1.001e-6


def test_tighter_tolerance_is_kept() -> None:
    arm = robot("panda")
    goal = arm.pose(random_positions(arm, 5, 1)[0])
    solution = PoseSolver(arm, eps_omega=1e-12, eps_v=1e-12).solve(goal)
    assert solution.converged
    assert float(np.abs(pin.log6(pin.SE3(se3.inverse(arm.pose(solution.q)) @ goal)).vector).max()) <= 1e-12


def test_bad_input_is_named() -> None:
    arm = robot("ur5")
    solver = PoseSolver(arm)
    with pytest.raises(InputError, match="pose_sd"):
        solver.solve(np.full((4, 4), np.nan))
    with pytest.raises(InputError, match="seed"):
        solver.solve(np.eye(4), [0.0] * 5)
    with pytest.raises(InputError, match="seed"):
        solver.solve(np.eye(4), [np.inf] * 6)
    with pytest.raises(InputError, match="restarts"):
        solver.solve(np.eye(4), restarts=-1)
    for wrong in ("eps_omega", "eps_v", "search_iterations", "max_iterations"):
        arguments: dict[str, Any] = {wrong: 0}
        with pytest.raises(InputError, match=wrong):
            PoseSolver(arm, **arguments)

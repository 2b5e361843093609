"""Inverse kinematics of a part of the pose: everything reachable is solved within the limits, success is judged on what
the task asks and on nothing else, and the solution is the one of least motion from the seed.

Poses are checked by a second Pinocchio model and scipy's rotations, without the functions that the solver uses."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from ik_node.inverse_kinematics.newton_raphson import TerminationReason
from ik_node.inverse_kinematics.pose_solver import COMPARED_SEARCHES, PoseSolver, solve_pose
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.catalogue import load_robot
from ik_node.robot.robot import Robot
from ik_node.robot.screw_chain import ScrewChain, finite_range

TASKS = {
    "all six": TaskTolerance(),
    "position": TaskTolerance((0.0, 0.0, 0.0, inf, inf, inf)),
    "pointing": TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf)),
    "+-0.2 rad": TaskTolerance((0.0, 0.0, 0.0, 0.2, 0.2, 0.2)),
}
ROBOTS = (
    "panda", "ur5", "ur3", "ur10", "kinova", "talos_arm", "xarm7", "z1", "b1-z1", "baxter", "pr2", "romeo_small",
    "icub", "tiago_pro", "simple_humanoid", "so100", "so101", "hextilt_flying_arm_5", "allegro_left_hand", "anymal",
    "finger_edu", "double_pendulum", "TwoDofs", "borinot_flying_arm_2",
)  # fmt: skip
"""24 arms, legs and fingers with 2 to 10 joints."""


def excess(task: str, reached: Array, wanted: Array) -> float:
    """Largest error in what the task asks, m or rad."""
    distance = float(np.linalg.norm(reached[:3, 3] - wanted[:3, 3]))
    rotation = Rotation.from_matrix(reached[:3, :3].T @ wanted[:3, :3]).as_rotvec()
    if task == "all six":
        return max(distance, float(np.linalg.norm(rotation)))
    if task == "pointing":
        axes = reached[:3, 2], wanted[:3, 2]
        return max(distance, float(np.arctan2(np.linalg.norm(np.cross(*axes)), np.dot(*axes))))
    if task == "+-0.2 rad":
        return max(distance, float(np.linalg.norm(np.maximum(np.abs(rotation) - 0.2, 0.0))))
    return distance


def components(task: str, reached: Array, wanted: Array) -> tuple[Array, Array]:
    """What has to be zero, and what must not be negative."""
    offset = reached[:3, 3] - wanted[:3, 3]
    rotation = Rotation.from_matrix(reached[:3, :3].T @ wanted[:3, :3]).as_rotvec()
    if task == "pointing":
        return np.concatenate((offset, wanted[:3, :2].T @ reached[:3, 2])), np.ones(1)
    if task == "+-0.2 rad":
        return offset, 0.2 - np.abs(rotation)
    return offset, np.ones(1)


def random_positions(arm: Robot, seed: int, count: int) -> Array:
    return np.random.default_rng(seed).uniform(*finite_range(arm), (count, arm.n))


class Reached:
    """Counts of one robot and task."""

    def __init__(self, name: str, task: str, count: int) -> None:
        arm, other = load_robot(name), load_robot(name)
        solver = PoseSolver(arm, tolerance=TASKS[task])
        self.iterations: list[int] = []
        self.unsolved: list[str] = []
        motions = []
        for q, seed in zip(random_positions(arm, 1, count), random_positions(arm, 2, count), strict=True):
            wanted = arm.pose(q)
            solution = solver.solve(wanted, seed)
            self.iterations.append(solution.iterations)
            motions.append(float(np.linalg.norm(solution.q - seed)))
            if not solution.converged:
                self.unsolved.append(solution.reason.value)
            elif (solution.q < arm.limits.lower).any() or (solution.q > arm.limits.upper).any():
                self.unsolved.append("outside the limits")
            elif (error := excess(task, other.pose(solution.q), wanted)) > 1.001e-6:
                self.unsolved.append(f"error {error:.2g}")
        self.row = (
            f"{name:<22}{arm.n:>3}  {task:<10}{count - len(self.unsolved):>6} of {count}"
            f"{np.mean(self.iterations):9.1f}{max(self.iterations):7d}{np.mean(motions):9.3f}"
        )


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("name", ROBOTS)
def test_reachable_poses_are_solved_within_limits(name: str, task: str) -> None:
    reached = Reached(name, task, 6)
    assert reached.unsolved == []
    assert max(reached.iterations) <= 3000


@pytest.mark.exhaustive
def test_500_poses_of_24_robots_are_solved_within_limits() -> None:
    # Run with -s for the table: solved, mean and maximum number of iterations, mean motion from the seed (rad, m).
    assert len(set(ROBOTS)) == 24
    print(f"\n{'robot':<22}{'n':>3}  {'task':<10}{'solved':>13}{'iter.':>9}{'max':>7}{'motion':>9}")
    unsolved = []
    for name in ROBOTS:
        for task in TASKS:
            reached = Reached(name, task, 500)
            print(reached.row, flush=True)
            unsolved += [f"{name} {task}: {reason}" for reason in reached.unsolved]
    assert unsolved == []


@pytest.mark.parametrize("frame", ["tool", "base"])
def test_the_whole_pose_gives_the_same_bits_in_both_frames(frame: str) -> None:
    arm = load_robot("panda")
    exact = PoseSolver(arm, tolerance=TaskTolerance((0.0,) * 6, frame))
    for q, seed in zip(random_positions(arm, 3, 5), random_positions(arm, 4, 5), strict=True):
        first, second = PoseSolver(arm).solve(arm.pose(q), seed), exact.solve(arm.pose(q), seed)
        assert np.array_equal(first.q, second.q)
        assert first.iterations == second.iterations


@pytest.mark.parametrize("name", ["panda", "ur5", "so101"])
@pytest.mark.parametrize("task", ["position", "pointing", "+-0.2 rad"])
def test_the_solution_is_the_nearest_to_the_seed(name: str, task: str) -> None:
    # Not further than that of the first search alone, and a local minimum of the distance from the seed.
    arm = load_robot(name)
    tolerance = TASKS[task]
    rng = np.random.default_rng(5)
    checked = 0
    for q in random_positions(arm, 6, 5):
        seed = np.clip(q + 0.4 * rng.normal(size=arm.n), arm.limits.lower, arm.limits.upper)
        wanted = arm.pose(q)
        solution = solve_pose(arm, wanted, seed, tolerance=tolerance)
        motion = float(np.linalg.norm(solution.q - seed))
        assert solution.converged
        single = solve_pose(arm, wanted, seed, tolerance=tolerance, restarts=0)
        assert single.searches == 1
        assert motion <= np.linalg.norm(single.q - seed) + 1e-6 or not single.converged

        def equalities(position: Array, wanted: Array = wanted) -> Array:
            return components(task, arm.pose(position), wanted)[0]

        def margins(position: Array, wanted: Array = wanted) -> Array:
            return components(task, arm.pose(position), wanted)[1]

        nearer = minimize(
            lambda position, seed=seed: float(np.sum((position - seed) ** 2)),
            solution.q,
            method="SLSQP",
            bounds=list(zip(arm.limits.lower, arm.limits.upper, strict=True)),
            constraints=[{"type": "eq", "fun": equalities}, {"type": "ineq", "fun": margins}],
        )
        if max(np.abs(equalities(nearer.x)).max(), -margins(nearer.x).min(initial=0.0)) < 1e-6:
            checked += 1
            assert np.linalg.norm(nearer.x - seed) > motion - 1e-3
    assert checked >= 3


def test_a_seed_that_fulfils_the_task_is_kept() -> None:
    # Success is judged on what the task asks: the seed has another orientation, or is inside a band.
    arm = load_robot("ur5")
    seed = np.array([0.4, -1.1, 1.3, -0.7, 0.9, 0.3])
    wanted = arm.pose(seed)
    spun, tilted = wanted.copy(), wanted.copy()
    spun[:3, :3] = wanted[:3, :3] @ Rotation.from_rotvec([0.0, 0.0, 3.1]).as_matrix()
    tilted[:3, :3] = wanted[:3, :3] @ Rotation.from_rotvec([0.1, -0.15, 0.12]).as_matrix()
    for task, target in (("pointing", spun), ("position", spun), ("+-0.2 rad", tilted)):
        solution = solve_pose(arm, target, seed, tolerance=TASKS[task])
        assert solution.converged
        np.testing.assert_allclose(solution.q, seed, atol=1e-6)
        assert solution.iterates[0].norm_omega <= 1e-9
    assert np.linalg.norm(solve_pose(arm, spun, seed).q - seed) > 1.0


def test_a_seed_a_turn_away_is_answered_a_turn_away() -> None:
    # The limits of ur5 have two turns; kinova has joints without limits, whose solutions are in -pi..pi.
    for name, motion in (("ur5", 1e-5), ("kinova", None)):
        arm = load_robot(name)
        middle = np.full(arm.n, 0.3) if name == "ur5" else np.array([0.4, 4.2, 1.6, 0.2, 1.8, 1.2])
        turns = arm.turning & ((arm.limits.upper - arm.limits.lower) > 4.0 * np.pi - 1e-3)
        seed = middle - 2.0 * np.pi * turns
        solution = solve_pose(arm, arm.pose(middle), seed, tolerance=TASKS["+-0.2 rad"])
        assert solution.converged
        assert turns.any()
        if motion is not None:
            np.testing.assert_allclose(solution.q, seed, atol=motion)
        else:
            np.testing.assert_allclose(solution.q, middle, atol=1e-5)


def test_out_of_reach_is_not_solved_with_a_tolerance() -> None:
    arm = load_robot("ur5")
    goal = np.eye(4)
    goal[:3, 3] = 3.0, 0.0, 0.5
    solution = PoseSolver(arm, max_iterations=200, tolerance=TASKS["position"]).solve(goal, np.zeros(6))
    assert not solution.converged
    assert solution.reason in {TerminationReason.STALLED, TerminationReason.CAP}
    assert solution.iterations == 200
    # The nearest point: the arm is stretched out towards the goal.
    assert np.linalg.norm(arm.pose(solution.q)[:3, 3] - goal[:3, 3]) < 2.2


def test_restarts_bound_the_number_of_searches() -> None:
    arm = load_robot("panda")
    q = random_positions(arm, 8, 1)[0]
    solution = solve_pose(arm, arm.pose(q), q, tolerance=TASKS["position"])
    assert solution.searches >= COMPARED_SEARCHES
    assert solve_pose(arm, arm.pose(q), q, tolerance=TASKS["position"], restarts=1).searches == 2
    assert solve_pose(arm, arm.pose(q), tolerance=TASKS["position"]).searches == 1  # no seed: nothing to be near to


@pytest.mark.parametrize("name", ["so100", "so101"])
def test_five_joints_follow_position_pitch_and_roll(name: str) -> None:
    # The yaw about the vertical of the base is free: targets with any other yaw are solved, those of the whole pose
    # are not. The base of both arms has a vertical z axis.
    arm = load_robot(name)
    tolerance = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf), "base")
    middle = 0.5 * (arm.limits.lower + arm.limits.upper)
    rng = np.random.default_rng(9)
    for q in random_positions(arm, 10, 10):
        wanted = arm.pose(q)
        wanted[:3, :3] = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)]).as_matrix() @ wanted[:3, :3]
        solution = solve_pose(arm, wanted, middle, tolerance=tolerance)
        assert solution.converged
        reached = arm.pose(solution.q)
        np.testing.assert_allclose(reached[:3, 3], wanted[:3, 3], atol=1.001e-6)
        np.testing.assert_allclose(reached[2, :3], wanted[2, :3], atol=1.001e-6)  # the vertical seen from the tool
        assert not PoseSolver(arm, max_iterations=300).solve(wanted).converged


@pytest.mark.parametrize("n", [3, 4])
def test_arms_of_three_and_four_joints_reach_positions(n: int) -> None:
    home, screws = load_robot("ur5").evaluate(np.zeros(6))
    chain = ScrewChain(home, screws[:, :n], [-3.0] * n, [3.0] * n)
    for q in np.random.default_rng(11).uniform(-2.5, 2.5, (10, n)):
        target = chain.pose(q)
        target[:3, :3] = np.eye(3)
        solution = solve_pose(chain, target, np.zeros(n), tolerance=TASKS["position"])
        assert solution.converged
        np.testing.assert_allclose(chain.pose(solution.q)[:3, 3], target[:3, 3], atol=1.001e-6)

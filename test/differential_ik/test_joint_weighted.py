"""The method joint_weighted: W = diag(joint_weights), and a joint with a larger weight moves less.

The optimum is compared with the solution of the optimality conditions (W qd = J' lambda, J qd = V) by a linear solver.
"""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from arms import random_position
from loop import READY, Loop, make_robot

from ik_node.differential_ik.closed_form import resolve
from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.errors import SettingsError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

ACCURACY = 1e-9


def least_weighted(jacobian: Array, twist: Array, weights: Array) -> Array:
    """Solution of the optimality conditions (n,)."""
    m, n = jacobian.shape
    matrix = np.block([[np.diag(weights), -jacobian.T], [jacobian, np.zeros((m, m))]])
    return np.linalg.solve(matrix, np.concatenate((np.zeros(n), twist)))[:n]


@pytest.mark.parametrize("rows", [3, 5, 6])
@pytest.mark.parametrize("name", ["panda", "xarm7", "talos_arm", "ur5"])
def test_the_answer_is_the_optimum_of_the_weights(name: str, rows: int) -> None:
    robot, rng = make_robot(name), np.random.default_rng(rows)
    for _ in range(50):
        q, weights = random_position(robot, rng), 10.0 ** rng.uniform(-3.0, 3.0, robot.n)
        jacobian, twist = robot.evaluate(q).jacobian_b[:rows], rng.normal(size=rows) * 0.1
        if np.linalg.svd(jacobian, compute_uv=False)[-1] < 0.05:
            continue
        weight, gradient = METHODS["joint_weighted"](robot, q, joint_weights=weights)
        found = resolve(jacobian, twist, weight, gradient).joint_velocity
        best = least_weighted(jacobian, twist, weights)
        assert np.abs(jacobian @ found - twist).max() < ACCURACY
        assert weights @ found**2 <= weights @ best**2 * (1.0 + ACCURACY)
        assert np.abs(found - best).max() < 1e-7 * (1.0 + np.abs(best).max()), "the reference has cond(W) 1e6"


def solver_of(robot: Robot, weights: Array | None, method: str = "joint_weighted") -> DifferentialIkSolver:
    given = () if weights is None else tuple(weights.tolist())
    values = {"method": method, "joint_weights": given, "obstacles.self_collision": False}
    return DifferentialIkSolver(robot, Settings().with_values({**values, "limits.acceleration": (1000.0,)}))


def at_rest(robot: Robot, q: Array) -> ArmState:
    return ArmState(q, q, np.zeros(robot.n), 0.002, 0)


def test_a_joint_with_a_larger_weight_moves_less() -> None:
    robot, rng = make_robot("panda"), np.random.default_rng(1)
    twist = np.array((0.05, 0.02, 0.0, 0.1, 0.0, 0.0))
    q = np.array(READY["panda"]) + rng.normal(size=7) * 0.1
    for joint in range(7):
        speeds = []
        for weight in (0.01, 1.0, 10.0, 1000.0):
            weights = np.ones(7)
            weights[joint] = weight
            solution = solver_of(robot, weights).solve_twist(at_rest(robot, q), twist)
            assert np.abs(robot.evaluate(q).jacobian_b @ solution.joint_velocity - twist).max() < ACCURACY
            speeds.append(abs(solution.joint_velocity[joint]))
        assert speeds == sorted(speeds, reverse=True)
        assert speeds[0] > speeds[-1]


def test_equal_weights_and_their_multiples_are_the_plain_method() -> None:
    robot = make_robot("panda")
    state, twist = at_rest(robot, np.array(READY["panda"]) + 0.1), np.array((0.05, 0.02, 0.0, 0.1, 0.0, 0.0))
    plain = solver_of(robot, None, "plain").solve_twist(state, twist).joint_velocity
    for weights in (None, np.ones(7), np.full(7, 20.0)):
        found = solver_of(robot, weights).solve_twist(state, twist).joint_velocity
        assert np.abs(found - plain).max() < ACCURACY


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        ((1.0, 2.0), r"joint_weights has 2 values; expected 7, in the order panda_joint1, .*panda_joint7"),
        ((1.0,) * 8, r"joint_weights has 8 values; expected 7"),
        ((1.0,) * 6 + (-1.0,), r"joint_weights is -1.0; valid: 0.001 to 1000"),
        ((0.0,) + (1.0,) * 6, r"joint_weights is 0.0; valid: 0.001 to 1000"),
        ((inf,) + (1.0,) * 6, r"joint_weights is \[inf, .*valid: finite numbers"),
        ((float("nan"),) + (1.0,) * 6, r"joint_weights is \[nan, .*valid: finite numbers"),
        ("heavy", r"joint_weights is 'heavy' \(string\); valid: a list of doubles"),
    ],
)
def test_wrong_weights_are_refused_in_one_line(weights: object, words: str) -> None:
    with pytest.raises(SettingsError, match=words) as error:
        solver_of(make_robot("panda"), None).configure(
            Settings().with_values({"method": "joint_weighted", "joint_weights": weights})
        )
    assert "\n" not in str(error.value)


def test_weights_change_while_the_arm_moves_without_a_jump() -> None:
    robot = make_robot("panda")
    loop = Loop(robot, READY["panda"], Settings().with_values({"method": "joint_weighted"}))
    loop.run(0.05)
    pose, begin_ns, moved = figure_of_eight(loop.pose()).pose, loop.time_ns, []
    for weight in (1.0, 1000.0, 1.0, 1000.0):
        changed = loop.controller.settings.with_values({"joint_weights": (1.0, 1.0, weight, 1.0, 1.0, 1.0, 1.0)})
        loop.controller.apply(changed)
        first = len(loop.steps)
        for _ in range(50):
            loop.target(pose((loop.time_ns - begin_ns) / NS))
            loop.run(0.02)
        speeds = np.array([step.joint_velocity[2] for step in loop.steps[first + 100 :]])
        moved.append(float(np.abs(speeds).max()))
        assert np.linalg.norm(loop.steps[-1].error_b[:3]) < 1e-3
    assert min(moved[0], moved[2]) > 5.0 * max(moved[1], moved[3])
    commands = np.array([step.joint_velocity for step in loop.steps])
    assert np.abs(np.diff(commands, axis=0)).max() * 500.0 <= 10.0 * (1.0 + 1e-6), "the acceleration limit"

"""The control step in compiled code gives the bits of the functions that it is composed of.

Both are compared with independent references in test_closed_form.py and test_constrained.py. Here: random arms,
positions, velocities, dampers and twists, from unlimited to huge ones; and the cases in which it has no solution.
"""

from __future__ import annotations

import numpy as np
import pytest
from arms import random_position
from loop import make_robot
from reference_solvers import METHODS, problem

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import constrained
from ik_node.differential_ik.closed_form import IDENTITY, NO_GRADIENT
from ik_node.differential_ik.compiled_step import LIMITED, StepSolution, solve_step, stacked_limits
from ik_node.differential_ik.constrained import binding_names
from ik_node.math.types import Array
from ik_node.robot.joint_limits import joint_bounds, motion_limits, relaxed
from ik_node.settings.groups import LimitSettings

ROW_SCALE = np.repeat((1.0, 0.2), 3)
CLEAR = 0.03
ELAPSED_S = 0.002


class Case:
    """A random control step; dampers in every second one."""

    def __init__(self, name: str, seed: int, method: str) -> None:
        rng = np.random.default_rng(seed)
        self.robot = make_robot(name)
        task = problem(self.robot, method, rng)
        n = self.robot.n
        self.limits = motion_limits(self.robot, LimitSettings(), 500.0)
        self.q = random_position(self.robot, rng)
        self.previous = rng.choice([0.0, 0.1, 1.0]) * rng.uniform(-1.0, 1.0, n) * self.limits.velocity
        self.jacobian, self.twist = task.jacobian, task.twist
        if rng.uniform() < 0.8:  # a moving arm that has to continue, slow down or accelerate
            self.previous = np.linalg.pinv(self.jacobian) @ self.jacobian @ self.previous * rng.choice([0.01, 0.1, 1.0])
            self.twist = self.jacobian @ self.previous * rng.choice([0.9, 1.0, 1.5])
        self.weight, self.gradient, self.gain = task.weight, task.gradient, task.gain
        rows = rng.normal(size=(seed % 2 * 3, n))
        least = rows @ self.previous - 10.0 ** rng.uniform(-4.0, 0.0, len(rows))
        self.dampers = VelocityDampers(rows, least, tuple(f"pair {row}" for row in range(len(rows))))
        self.cap = np.full(n, 0.5)
        self.bounds = joint_bounds(self.limits, self.q, self.previous, ELAPSED_S)

    def step(self, jacobian: Array | None = None, twist: Array | None = None) -> StepSolution:
        return solve_step(
            self.jacobian if jacobian is None else jacobian,
            self.twist if twist is None else twist,
            ROW_SCALE,
            CLEAR,
            IDENTITY if self.weight is None else self.weight,
            NO_GRADIENT if self.gradient is None else self.gradient,
            self.gain,
            stacked_limits(self.limits, self.cap),
            self.limits.dt_max_s,
            self.limits.recovery_speed,
            self.q,
            self.previous,
            ELAPSED_S,
            *self.dampers[:2],
        )

    def composed(self) -> constrained.ConstrainedSolution:
        return constrained.solve(
            self.jacobian,
            self.twist,
            self.bounds.lo,
            self.bounds.hi,
            self.weight,
            self.gradient,
            self.gain,
            row_scale=ROW_SCALE,
            null_space_cap=self.cap,
            dampers=self.dampers,
        )

    def names(self, answer: StepSolution) -> tuple[str, ...]:
        return binding_names(answer.sides, self.bounds, self.robot.joints, self.dampers.names)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_one_pass_agrees_with_its_parts(name: str, method: str) -> None:
    solved = bound = 0
    for seed in range(200):
        case = Case(name, seed, method)
        answer, expected = case.step(), case.composed()
        smallest = np.linalg.svd(ROW_SCALE[:, None] * case.jacobian, compute_uv=False)[-1]
        if not answer.is_solved:
            at_rest = np.minimum(np.maximum(0.0, case.bounds.lo), case.bounds.hi)
            hindered = bool((case.dampers.rows @ at_rest < case.dampers.least).any())
            names = relaxed(case.bounds, case.robot.joints)
            astray = case.jacobian @ expected.base_velocity - expected.base_scale * case.twist
            assert smallest < CLEAR or hindered or names or np.abs(astray).max() > 1e-9
            continue
        solved += 1
        bound += answer.status == LIMITED
        assert smallest >= CLEAR
        assert answer.task_scale == expected.task_scale
        assert (answer.joint_velocity == expected.joint_velocity).all()
        assert (answer.multiplier_task == expected.unconstrained.multiplier_task).all()
        assert answer.svd.sigma[-1] == pytest.approx(smallest, rel=1e-12)
        assert case.names(answer) == expected.binding(case.bounds, case.robot.joints, case.dampers)
        assert (answer.joint_velocity >= case.bounds.lo).all()
        assert (answer.joint_velocity <= case.bounds.hi).all()
    assert solved > 60
    assert bound > 10
    # A random gradient drives the null space faster than an arm at rest may start.
    assert bound < solved or method == "obstacle_gradient"


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_input_that_is_not_finite_is_not_solved(value: float) -> None:
    case = Case("panda", 1, "inertia_weighted")
    twist = case.twist.copy()
    twist[3] = value
    assert not case.step(twist=twist).is_solved
    jacobian = case.jacobian.copy()
    jacobian[2, 3] = value
    with pytest.raises(np.linalg.LinAlgError):
        case.step(jacobian=jacobian)

"""The prediction of a chain from its present Jacobian agrees with the kinematics of the model."""

from __future__ import annotations

import numpy as np
import pytest
from loop import make_robot

from ik_node.robot.chain import damped_rates, moved_chain, relative_speeds

ROW_SCALE = np.repeat((1.0, 0.3), 3)


@pytest.mark.parametrize("name", ["ur5", "panda", "talos_arm", "xarm7", "z1"])
def test_jacobian_and_pose_ahead_are_those_of_the_model(name: str) -> None:
    robot, rng = make_robot(name), np.random.default_rng(1)
    for _ in range(20):
        q, change = rng.uniform(-1.0, 1.0, robot.n), rng.uniform(-1.0, 1.0, robot.n)
        before, after = robot.evaluate(q), robot.evaluate(q + change)
        jacobian, back = moved_chain(before.jacobian_b, robot.chain_order, change)
        np.testing.assert_allclose(jacobian, after.jacobian_b, atol=1e-13)
        np.testing.assert_allclose(after.pose_sb @ back, before.pose_sb, atol=1e-13)


def test_damped_rates_minimise_the_damped_error() -> None:
    """Normal equations of |D (J qd - V)|^2 + damping^2 |qd / speeds|^2, for six and seven joints."""
    rng = np.random.default_rng(2)
    for n in (6, 7):
        jacobian, twist, damping, speeds = rng.normal(size=(6, n)), rng.normal(size=6), 0.1, rng.uniform(0.1, 1.0, n)
        scaled = ROW_SCALE[:, None] * jacobian
        normal = scaled.T @ scaled + damping**2 * np.diag(1.0 / speeds**2)
        expected = np.linalg.solve(normal, scaled.T @ (ROW_SCALE * twist))
        np.testing.assert_allclose(damped_rates(jacobian, twist, ROW_SCALE, damping, speeds), expected, atol=1e-12)


def test_relative_speeds() -> None:
    """Joints slower than 0.3 times the fastest have less than 1; arms without a null space have 1 everywhere."""
    limits = np.array((2.0, 0.06, np.inf, 1.0, 2.0, 0.3, 2.0))
    np.testing.assert_allclose(relative_speeds(limits), (1.0, 0.1, 1.0, 1.0, 1.0, 0.5, 1.0))
    np.testing.assert_allclose(relative_speeds(limits[:6]), np.ones(6))

"""Methods and control laws in closed loop: each has its intended effect, none is unstable, switching causes no jump.

Formulas are tested in test_closed_form.py; here they move an arm.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.differential_ik.methods import METHODS
from ik_node.interfaces.clock import NS
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import ArmModel
from ik_node.settings.groups import CONTROL_LAWS, Settings
from ik_node.settings.method_names import METHOD_NAMES as NAMES
from ik_node.trajectory.shapes import figure_of_eight

LATE = ArmModel(lag_s=0.02, delay_s=0.002)


@pytest.fixture(scope="module")
def panda() -> Robot:
    return make_robot("panda")


def follow(robot: Robot, model: ArmModel | None = None, duration_s: float = 10.0, **values: object) -> Loop:
    settings = Settings().with_values({name.replace("__", "."): value for name, value in values.items()})
    loop = Loop(robot, READY["panda" if robot.n == 7 else "ur5"], settings, model)
    loop.run(0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, duration_s, 100.0)
    return loop


@cache
def followed(method: str) -> Loop:
    """The run of a Panda on the path of 10 s."""
    return follow(make_robot("panda"), method=method)


def commands(loop: Loop) -> Array:
    return np.array([step.joint_velocity for step in loop.steps])


def position_error(loop: Loop) -> float:
    return max(float(np.linalg.norm(step.error_b[:3])) for step in loop.steps[500:])


def kinetic_energy(loop: Loop) -> float:
    """Mean over the run, J."""
    return float(
        np.mean(
            [
                0.5 * step.joint_velocity @ loop.robot.dynamics(step.joint_position).mass_matrix @ step.joint_velocity
                for step in loop.steps[::20]
            ]
        )
    )


def test_the_names_that_settings_offer_are_the_methods_there_are() -> None:
    assert set(NAMES) == set(METHODS)


@pytest.mark.parametrize("method", NAMES)
def test_every_method_follows_the_same_path(method: str) -> None:
    loop = followed(method)
    # Gravity pulls the null space towards the arm itself, where a velocity damper stops it and the tool deviates
    # slightly.
    assert position_error(loop) < (1e-3 if method == "gravity_gradient" else 1e-6), "to the error of one step"


def test_inertia_weighting_needs_less_kinetic_energy_than_plain(panda: Robot) -> None:
    """Compared at the same q and V along the path of the first second, because the two runs diverge."""
    plain = follow(panda, duration_s=2.0)
    for step in plain.steps[100::50]:
        mass = panda.dynamics(step.joint_position).mass_matrix
        jacobian = panda.evaluate(step.joint_position).jacobian_b
        twist = jacobian @ step.joint_velocity
        weighted = np.linalg.solve(mass, jacobian.T) @ np.linalg.solve(
            jacobian @ np.linalg.solve(mass, jacobian.T), twist
        )
        assert weighted @ mass @ weighted <= step.joint_velocity @ mass @ step.joint_velocity * (1 + 1e-12)
    assert kinetic_energy(followed("inertia_weighted")) < kinetic_energy(followed("plain"))


def still(robot: Robot, start: Array, model: ArmModel | None, **values: object) -> Loop:
    """Hold the pose for 15 s while the null space is free to move."""
    settings = Settings().with_values({"method": "gravity_gradient", **values})
    loop = Loop(robot, start, settings, model)
    loop.run(15.0)
    return loop


@pytest.mark.parametrize("model", [ArmModel(), LATE], ids=["ideal", "late"])
def test_the_gravity_gradient_moves_the_null_space_downhill_gently_and_comes_to_rest(
    panda: Robot, model: ArmModel
) -> None:
    generator = np.random.default_rng(3)
    for _ in range(2):
        lower, upper = panda.limits.lower, panda.limits.upper
        start = generator.uniform(0.8 * lower + 0.2 * upper, 0.2 * lower + 0.8 * upper)
        loop = still(panda, start, model)
        qd = commands(loop)
        assert np.abs(qd).max() <= 0.3 * 1.05, "the limit on the null-space speed, plus the feedback"
        assert np.abs(qd).max() > 1e-3, "the null space has to move for this test to be valid"
        changes = np.abs(np.diff(np.sign(np.where(np.abs(qd) > 1e-4, qd, 0.0)), axis=0)) == 2
        assert changes.sum(axis=0).max() <= 6, "no chatter"
        begin, end = loop.steps[10], loop.steps[-1]
        assert np.abs(begin.pose_sb[:3, 3] - end.pose_sb[:3, 3]).max() < 1e-3, "the tool does not move"


@pytest.mark.parametrize("name", ["panda", "xarm7"])
def test_the_default_gain_is_stable_in_discrete_time_with_a_wide_margin(name: str) -> None:
    """One step of z' = -k (N' M N)^-1 N' H N z must not overshoot, H the Hessian of gravity by finite differences.

    At 100 Hz on an arm with 20 ms of lag, everywhere within the limits.
    """
    robot, generator, step = make_robot(name), np.random.default_rng(4), 1e-5
    gain, late_s = Settings().control.gradient_gain, 0.01 + 0.02
    fastest = 0.0
    for _ in range(100):
        q = generator.uniform(np.maximum(robot.limits.lower, -np.pi), np.minimum(robot.limits.upper, np.pi))
        null = np.linalg.svd(robot.evaluate(q).jacobian_b)[2][6:].T
        shifts = step * np.eye(robot.n)
        hessian = np.array([robot.dynamics(q + d).gravity - robot.dynamics(q - d).gravity for d in shifts]) / (2 * step)
        mass = robot.dynamics(q).mass_matrix
        rate = np.linalg.eigvals(np.linalg.solve(null.T @ mass @ null, null.T @ hessian @ null))
        fastest = max(fastest, float(np.abs(rate).max()))
    assert fastest > 50.0, "gravity has to act for this test to be valid"
    assert gain * fastest * late_s < 0.5


def test_the_potential_multiplier_of_a_square_arm_is_what_holds_it_against_gravity() -> None:
    """k times the wrench on the tool that balances gravity: J' lambda_2 = k g where J is square."""
    robot = make_robot("ur5")
    step = follow(robot, duration_s=1.0, method="gravity_gradient").steps[-1]
    gravity = robot.dynamics(step.joint_position).gravity
    jacobian = robot.evaluate(step.joint_position).jacobian_b
    assert np.abs(jacobian.T @ step.multiplier_potential - 0.02 * gravity).max() < 1e-3 * np.abs(0.02 * gravity).max()


# --- control laws -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_ik_difference_at_one_over_dt_is_the_law_of_the_notes_and_follows_an_ideal_arm(name: str) -> None:
    loop = follow(make_robot(name), control_law="ik_difference", ik_difference_gain=500.0)
    truth = figure_of_eight(loop.steps[0].pose_sb)
    assert position_error(loop) < 0.5e-3, "one period of lag"
    assert "without lag" in loop.controller.status.reason, "the node warns of this gain"
    del truth


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_ik_difference_is_stable_on_a_late_arm_by_default(name: str) -> None:
    loop = follow(make_robot(name), LATE, control_law="ik_difference")
    assert position_error(loop) < 0.02
    loop.run(3.0)
    assert np.abs(loop.steps[-1].joint_velocity).max() < 1e-3, "the arm comes to rest"
    assert "without lag" not in loop.controller.status.reason


def test_ik_difference_at_one_over_dt_is_not_stable_on_a_late_arm(panda: Robot) -> None:
    """The reason for another default gain."""
    loop = follow(panda, LATE, duration_s=3.0, control_law="ik_difference", ik_difference_gain=500.0)
    assert np.abs(np.diff(commands(loop)[-250:], axis=0)).max() > 0.01


@pytest.mark.parametrize("law", CONTROL_LAWS)
def test_switching_methods_and_laws_while_moving_is_no_jump(panda: Robot, law: str) -> None:
    loop = Loop(panda, READY["panda"])
    loop.run(0.05)
    pose, begin_ns = figure_of_eight(loop.pose()).pose, loop.time_ns
    choices = [(method, other) for method in NAMES for other in (law, *CONTROL_LAWS)]
    for index in range(450):
        if index % 15 == 7:
            method, other = choices[(index // 15) % len(choices)]
            changed = loop.controller.settings.with_values({"method": method, "control_law": other})
            loop.controller.apply(changed)
        loop.target(pose((loop.time_ns - begin_ns) / NS))
        loop.run(0.02)
    rate = np.abs(np.diff(commands(loop), axis=0)).max() * 500.0
    assert rate <= 10.0 * (1 + 1e-6), "the acceleration limit"
    assert np.linalg.norm(loop.steps[-1].error_b[:3]) < 0.03
    wandered = se3.log(se3.inverse(loop.steps[0].pose_sb) @ loop.pose())
    assert np.isfinite(wandered).all()

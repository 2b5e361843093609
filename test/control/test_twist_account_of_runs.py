"""The account of a twist over whole runs: no control step has a remainder, and motion off the direction is reported.

The target moves along random joint motions to positions beside their limits and through singular ones, as in
``direction_cases``: with the default limits the joints cannot follow each change of the twist. The feedback law defers
such changes; the law in joint space leaves the direction.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from independent_kinematics import Kinematics
from loop import READY, Loop, make_robot

from ik_node.control.status import RELEASE_S
from ik_node.control.velocity_controller import DEFERRED
from ik_node.differential_ik.methods import METHODS
from ik_node.interfaces.step import OFF_DIRECTION, Mode, Step
from ik_node.interfaces.twist_account import TwistAccount, twist_account
from ik_node.math.types import Array
from ik_node.messages.step_outputs import step_values
from ik_node.settings.groups import Settings

RATE_HZ = 500.0
MAX_REMAINDER = 1e-9
"""m/s, rad/s."""
ROW_SCALE = np.repeat((1.0, 0.3), 3)
STEPS = 2000


JOINT_SPACE_LAW = {"control_law": "ik_difference", "ik_difference_gain": 100.0}


def run_through_limits(name: str, seed: int, **values: object) -> Loop:
    """A run with a stream of poses at 50 Hz whose joint motion changes every second."""
    robot = make_robot(name)
    settings = Settings().with_values({"rate_hz": RATE_HZ, "obstacles.self_collision": False, **values})
    rng, low, high = np.random.default_rng(seed), robot.limits.lower, robot.limits.upper
    start = low + (high - low) * rng.uniform(0.3, 0.7, robot.n)
    loop, aim, goal = Loop(robot, start, settings), start.copy(), start
    for tick in range(STEPS):
        if tick % 500 == 0:
            goal = low + (high - low) * rng.choice([0.02, 0.5, 0.98], robot.n)
        if tick % 10 == 0 and tick > 0:
            aim = aim + np.clip(goal - aim, -0.02, 0.02)
            loop.target(robot.pose(aim))
        loop.tick()
    return loop


def account_of(step: Step) -> TwistAccount:
    return twist_account(step.twist_b, step.truncated_b, step.off_direction_b, step.scale)


def remainders(loop: Loop) -> list[tuple[Step, float]]:
    """Each step in closed loop, and the largest component of V less all parts of its account, with J by Pinocchio."""
    kinematics, previous, found = Kinematics(loop.robot), np.zeros(loop.robot.n), []
    for step in loop.steps:
        if np.isfinite(step.scale):
            done = kinematics.jacobian(step.joint_position + 0.5 / RATE_HZ * previous) @ step.joint_velocity
            account = account_of(step)
            parts: Array = done + account.held_back + account.truncated - account.off_direction
            found.append((step, float(np.abs(step.twist_b - parts).max())))
        previous = step.joint_velocity
    return found


def scaled_norm(vector: Array) -> float:
    return float(np.linalg.norm(ROW_SCALE * vector))


@pytest.mark.parametrize("name", ["ur5", "panda", "xarm7", "z1", "talos_arm", "ur10"])
def test_no_control_step_of_a_run_has_a_remainder(name: str) -> None:
    """One method per robot; the exhaustive test has all of them."""
    method = list(METHODS)[sum(map(ord, name)) % len(METHODS)]
    check_run(run_through_limits(name, 20261127, method=method))


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_no_control_step_of_the_joint_space_law_has_a_remainder(name: str) -> None:
    """V is J times the joint velocity of the law, whether limits bind or not."""
    check_run(run_through_limits(name, 7, **JOINT_SPACE_LAW), 20)


@pytest.mark.exhaustive
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["ur5", "panda", "xarm7", "z1", "talos_arm", "ur10"])
def test_no_control_step_of_any_method_has_a_remainder(name: str, method: str) -> None:
    check_run(run_through_limits(name, 5, method=method))


def check_run(loop: Loop, least_off_steps: int = -1) -> None:
    """No remainder; each motion off the direction beyond the threshold of the warning is in the status, and only it."""
    steps = remainders(loop)
    assert len(steps) > 0.9 * STEPS
    assert max(remainder for _, remainder in steps) < MAX_REMAINDER
    last_s, off_steps = -np.inf, 0
    for step, _ in steps:
        off, wanted = scaled_norm(step.off_direction_b), scaled_norm(step.twist_b)
        time_s = step.now.monotonic_ns * 1e-9
        if off > max(1.001e-3, 0.01001 * wanted):
            last_s, off_steps = time_s, off_steps + 1
            assert step.off_direction_limits
            assert any(text in step.status.reason for text in step.off_direction_limits) or OFF_DIRECTION in (
                step.status.reason
            )
        elif time_s > last_s + RELEASE_S + 2.0 / RATE_HZ:
            assert OFF_DIRECTION not in step.status.reason
    assert off_steps > least_off_steps, "the run must leave the direction for this test to be valid"


def test_the_status_names_the_limit_and_changes_rarely() -> None:
    """The speed is rounded up in the series 1, 2, 5, and one text is in force at a time."""
    loop = run_through_limits("ur5", 20261127, **JOINT_SPACE_LAW)
    texts = [step.status.reason for step in loop.steps if step.status.mode is Mode.TRACKING]
    warned = [text for text in texts if OFF_DIRECTION in text]
    assert warned
    assert all(text.count(OFF_DIRECTION) == 1 for text in warned)
    first = next(part for part in warned[0].split("; ") if OFF_DIRECTION in part)
    speed, limit = first.removeprefix(f"{OFF_DIRECTION} by up to ").split(" m/s: ")
    assert f"{float(speed):e}"[0] in "125"
    kind, joint = limit.split(" ")
    assert kind in ("acceleration", "velocity", "position")
    assert joint in loop.robot.joints
    changes = sum(before != after for before, after in pairwise(texts))
    assert changes < 0.03 * len(texts)


def test_the_published_values_are_those_of_the_account() -> None:
    """Norms of linear and angular parts beside scale and truncated twist."""
    loop = run_through_limits("ur5", 20261127, **JOINT_SPACE_LAW)
    step = max(
        (step for step in loop.steps if np.isfinite(step.scale)), key=lambda step: scaled_norm(step.off_direction_b)
    )
    account, values = account_of(step), step_values(step, "plain")
    for key, part in (("held_back", account.held_back), ("truncated", account.truncated)):
        assert float(values[f"{key}_linear_m_s"]) == pytest.approx(np.linalg.norm(part[:3]), rel=1e-5)
        assert float(values[f"{key}_angular_rad_s"]) == pytest.approx(np.linalg.norm(part[3:]), rel=1e-5)
    assert float(values["off_direction_linear_m_s"]) > 0.01
    assert values["off_direction_limits"] == ", ".join(step.off_direction_limits)


def test_a_deferred_change_of_the_twist_is_in_the_account_and_in_the_status() -> None:
    """Far from singularities ``truncated_b`` is what is deferred."""
    loop = run_through_limits("ur5", 20261127)
    deferred = [
        step
        for step in loop.steps
        if np.isfinite(step.scale)
        and step.singular_values[-1] > 0.12
        and scaled_norm(step.truncated_b) > max(0.01, 0.02 * scaled_norm(step.twist_b))
    ]
    assert len(deferred) > 20
    for step in deferred:
        assert DEFERRED in step.status.reason


def test_a_run_within_all_limits_has_no_warning() -> None:
    """A slow circle: V is done completely."""
    robot = make_robot("panda")
    loop = Loop(robot, READY["panda"])
    start = loop.pose()

    def pose(time_s: float) -> Array:
        moved = start.copy()
        moved[0, 3] += 0.02 * (1.0 - np.cos(1.5 * time_s))
        return np.asarray(moved)

    loop.follow(pose, 2.0, 100.0)
    steps = [step for step in loop.steps if np.isfinite(step.scale)]
    assert max(float(np.abs(account_of(step).missing).max()) for step in steps) < 1e-9
    assert not any(step.off_direction_limits or OFF_DIRECTION in step.status.reason for step in steps)

"""Locked joints: they ramp to rest, and the others solve the problem without them.

The reduced problem is made with an independent Jacobian; its optimum is checked by a linear program for s (HiGHS) and
by DAQP for the cost.
"""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import daqp
import numpy as np
import pytest
from arms import random_position
from independent_kinematics import Kinematics
from loop import READY, Loop, make_robot
from random_states import cases, solve
from recorded_loop import finish, recorded_loop
from scipy.optimize import linprog

from ik_node.differential_ik.methods import METHODS
from ik_node.differential_ik.solution import ArmState
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.errors import SettingsError
from ik_node.interfaces.samples import ObstacleSample
from ik_node.interfaces.step import Level
from ik_node.interfaces.twist_account import twist_account
from ik_node.math.types import Array
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.robot.joint_limits import joint_bounds
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

ACCURACY = 1e-9
LOCKED = {"panda": (2,), "xarm7": (0, 3), "talos_arm": (4,), "ur5": (5,), "ur10": (0,), "z1": (3, 4)}
"""Robot -> indices of the locked joints."""
POINTING = (0.0, 0.0, 0.0, 0.0, 0.0, inf)


def names_of(robot: Robot, indices: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(robot.joints[index] for index in indices)


def solver_of(robot: Robot, locked: tuple[int, ...], **values: Any) -> DifferentialIkSolver:
    given = {"locked_joints": names_of(robot, locked), "obstacles.self_collision": False, "rate_hz": 500.0}
    return DifferentialIkSolver(robot, Settings().with_values({**given, **values}))


def largest_scale(jacobian: Array, twist: Array, lo: Array, hi: Array) -> float:
    """Largest s with J qd = s V within the box, V in the range of J; NaN where the linear program finds none."""
    u, sigma, rows = np.linalg.svd(jacobian, full_matrices=False)
    matrix, goal = np.column_stack((rows, -(u.T @ twist) / sigma)), np.append(np.zeros(len(lo)), -1.0)
    box = [*zip(lo.tolist(), hi.tolist(), strict=True), (0.0, 1.0)]
    options = {"primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}
    found = linprog(goal, A_eq=matrix, b_eq=np.zeros(len(sigma)), bounds=box, method="highs", options=options)
    return float(found.x[-1]) if found.status == 0 else float("nan")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", LOCKED)
def test_the_answer_is_the_optimum_of_the_other_joints(name: str, method: str) -> None:
    """With and without active limits; joints at rest or moving."""
    robot, locked = make_robot(name), LOCKED[name]
    kinematics, rng = Kinematics(robot), np.random.default_rng(1)
    free = np.setdiff1d(np.arange(robot.n), locked)
    weights = 10.0 ** rng.uniform(-1.0, 1.0, robot.n)
    values = {"method": method, "gradient_gain": 1e-5, "joint_weights": tuple(weights.tolist())}
    solver, limited, compared = solver_of(robot, locked, **values), 0, 0
    for _ in range(400):
        q = random_position(robot, rng)
        previous = np.zeros(robot.n)
        previous[free] = rng.choice([0.0, 0.02]) * rng.uniform(-1.0, 1.0, len(free))
        state = ArmState(q, q, previous, 0.01, 0)
        jacobian = kinematics.jacobian(q)
        reduced = np.ascontiguousarray(jacobian[:, free])
        twist = reduced @ rng.normal(size=len(free)) * 10.0 ** rng.uniform(-2.0, 1.0)
        if np.linalg.svd(np.repeat((1.0, 0.3), 3)[:, None] * reduced, compute_uv=False)[-1] < 0.13:
            continue
        solver.reset()
        found = solver.solve_twist(state, twist)
        qd, s = found.joint_velocity, found.task_scale
        assert not qd[list(locked)].any(), "a joint at rest stays there"
        bounds = joint_bounds(solver.limits, q, previous, 0.01)
        lo, hi = bounds.lo[free], bounds.hi[free]
        weight, pull = np.eye(robot.n), np.zeros(robot.n)
        if method == "joint_weighted":
            weight = np.diag(weights)
        elif method != "plain":
            weight = robot.dynamics(q).mass_matrix
            pull = 1e-5 * robot.dynamics(q).gravity if method == "gravity_gradient" else pull
        weight, pull = np.ascontiguousarray(weight[np.ix_(free, free)]), pull[free]
        best = largest_scale(reduced, twist, lo, hi)
        if np.isnan(best):
            continue  # no multiple of the twist: test_least_off_direction
        assert np.abs(reduced @ qd[free] - s * twist).max() < 1e-8 * max(1.0, np.abs(twist).max())
        assert s == pytest.approx(best, abs=1e-6)
        upper, lower = np.concatenate((hi, reduced @ qd[free])), np.concatenate((lo, reduced @ qd[free]))
        other, _, flag, _ = daqp.solve(weight, pull, reduced, upper, lower, primal_tol=1e-11)
        cost, reference = (0.5 * x @ weight @ x + pull @ x for x in (qd[free], other))
        if flag == 1:
            assert cost - reference < ACCURACY * (1.0 + abs(reference))
            compared += 1
        limited += s < 1.0
    assert compared > 8
    assert limited > 2


@pytest.mark.parametrize("name", LOCKED)
def test_the_account_has_no_remainder_while_joints_are_locked(name: str) -> None:
    """Random states beside limits and singularities; locked joints ramp from any velocity within their acceleration."""
    robot, locked = make_robot(name), LOCKED[name]
    kinematics, indices = Kinematics(robot), list(locked)
    ramping = 0
    for number, method in enumerate(METHODS):
        solver, rng = solver_of(robot, locked, method=method), np.random.default_rng(number)
        source = cases(robot, kinematics, solver, rng)
        case = next(source)
        for _ in range(120):
            previous = case.state.previous[indices]
            twist = case.twist
            if case.velocity_wanted is not None:
                twist = solver.twist_of(case.state, case.velocity_wanted)
            solution = solve(solver, case)
            command = solution.joint_velocity
            account = twist_account(twist, solution.truncated_b, solution.off_direction_b, solution.task_scale)
            done = kinematics.jacobian(case.state.q_middle) @ command
            parts = done + account.held_back + account.truncated - account.off_direction
            assert np.abs(twist - parts).max() < ACCURACY
            change = solver.limits.acceleration[indices] * min(case.state.elapsed_s, solver.limits.dt_max_s)
            expected = np.sign(previous) * np.maximum(np.abs(previous) - change, 0.0)
            assert np.abs(command[indices] - expected).max() < ACCURACY
            assert solution.singular_values.shape == (min(6, robot.n),)
            ramping += bool(expected.any())
            if np.abs(account.off_direction).max() > 1e-7 and len(robot.joints) - len(locked) >= 6:
                assert solution.off_direction_limits
            case = source.send(command)
    assert ramping > 50


def test_a_singularity_that_needs_the_locked_joint_is_that_of_the_others() -> None:
    """Singular values are those of the free columns."""
    robot = make_robot("panda")
    solver, q = solver_of(robot, (2,)), np.array(READY["panda"])
    state = ArmState(q, q, np.zeros(7), 0.002, 0)
    scaled = np.repeat((1.0, 0.3), 3)[:, None] * robot.evaluate(q).jacobian_b
    found = solver.solve_twist(state, np.array((0.01, 0.0, 0.0, 0.0, 0.0, 0.0))).singular_values
    expected = np.linalg.svd(np.delete(scaled, 2, axis=1), compute_uv=False)
    assert np.abs(found - expected).max() < ACCURACY


# --- in the control loop ---


def locking(loop: Loop, *names: str) -> None:
    loop.controller.apply(loop.controller.settings.with_values({"locked_joints": names}))


class Locking(NamedTuple):
    """A run along a figure of eight."""

    commands: Array
    errors: Array
    """Distances of the tool from its target, m."""
    locked: int
    """Control step from which panda_joint1 is locked."""
    released: int
    level: Level


def followed(law: str, locks: bool) -> Locking:
    values = {"control_law": law, "ik_difference_gain": 20.0, "obstacles.self_collision": False}
    loop = Loop(make_robot("panda"), np.array(READY["panda"]) + 0.2, Settings().with_values(values))
    loop.run(0.05)
    pose, begin_ns = figure_of_eight(loop.pose()).pose, loop.time_ns
    locked = released = 0
    for index in range(400):
        if not locked and index > 60 and abs(loop.steps[-1].joint_velocity[0]) > 0.02:
            locking(loop, *(("panda_joint1",) if locks else ()))
            locked = len(loop.steps)
        if index == 250:
            locking(loop)
            released = len(loop.steps)
        loop.target(pose((loop.time_ns - begin_ns) * 1e-9))
        loop.run(0.02)
    commands = np.array([step.joint_velocity for step in loop.steps])
    errors = np.array([np.linalg.norm(step.error_b[:3]) for step in loop.steps])
    return Locking(commands, errors, locked, released, loop.controller.status.level)


@pytest.mark.parametrize("law", ["twist_feedback", "ik_difference"])
def test_a_joint_is_locked_and_released_while_the_tool_moves(law: str) -> None:
    """It rests after its ramp, and the tool stays on its path as without a lock."""
    (commands, errors, first, last, level), without = followed(law, True), followed(law, False)
    assert 0 < first < last - 500
    rates = np.abs(np.diff(commands, axis=0)).max() * 500.0
    assert rates <= 10.0 * (1.0 + 1e-6), "the acceleration limit"
    assert abs(commands[first - 1, 0]) > 0.02, "the joint has to move for this test to be valid"
    rest = first + int(np.ceil(abs(commands[first - 1, 0]) / (10.0 * 0.002))) + 1
    assert not commands[rest:last, 0].any()
    assert np.abs(without.commands[rest:last, 0]).max() > 0.02
    assert np.abs(commands[last + 50 :, 0]).max() > 0.01
    assert errors[first:].max() < 1.2 * without.errors[first:].max() + 1e-5
    assert level is Level.OK


def test_what_can_no_longer_be_followed_is_said_and_nothing_else() -> None:
    robot = make_robot("ur5")
    loop = Loop(robot, READY["ur5"])
    loop.run(0.05)
    locking(loop, "wrist_3_joint")
    loop.run(0.05)
    words = (
        "wrist_3_joint locked: the arm can follow 5 of 6 exact components in general; the deviation is the least one"
    )
    assert words in loop.controller.status.reason
    loop.controller.apply(loop.controller.settings.with_values({"task.tolerance": POINTING}))
    loop.run(0.3)
    assert loop.controller.status.level is Level.OK
    goal = loop.pose()
    goal[:3, 3] += (0.05, 0.05, 0.05)
    loop.run(2.0, lambda: loop.target(goal))
    assert np.linalg.norm(loop.steps[-1].error_b) < 1e-4
    assert loop.steps[-1].joint_position[5] == pytest.approx(READY["ur5"][5], abs=1e-9)
    locking(loop)
    loop.controller.apply(loop.controller.settings.with_values({"task.tolerance": (0.0,) * 6}))
    loop.run(0.3)
    assert "can follow" not in loop.controller.status.reason
    at_start = Loop(robot, READY["ur5"], Settings().with_values({"locked_joints": ("elbow_joint",)}))
    at_start.run(0.05)
    assert "elbow_joint locked: the arm can follow 5 of 6" in at_start.controller.status.reason
    assert "proposed tolerance" in at_start.controller.status.reason


def test_velocity_dampers_hold_with_a_locked_joint() -> None:
    """A target inside an obstacle, while joints are locked one after the other."""
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.05)
    goal = loop.pose()
    goal[1, 3] += 0.25
    centre, upright = goal[:3, 3].copy(), np.array((0.0, 0.0, 0.0, 1.0))
    ball = ObstacleSample(0, loop.robot.base_frame, "ball", "add", "sphere", (0.1,), centre, upright, 0)
    loop.controller.on_obstacles((ball,), loop.now)
    for names in ((), ("panda_joint1",), ("panda_joint1", "panda_joint4"), ("panda_joint2",)):
        locking(loop, *names)
        loop.run(0.5, lambda: loop.target(goal))
    clearance = np.array([step.clearance for step in loop.steps])
    assert np.nanmin(clearance) > 0.009, "the stop distance of 10 mm"
    assert np.nanmin(clearance) < 0.05, "the arm has to come near"


def test_a_recording_with_locked_joints_gives_the_same_bits(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0, "control_law": "ik_difference"})
    controller: Any = loop.controller
    for names in ((), ("panda_joint3",), ("panda_joint3", "panda_joint6"), ()):
        controller.apply(controller.settings.with_values({"locked_joints": names}), loop.now)
        loop.follow(figure_of_eight(loop.pose()).pose, 0.5, 50.0)
    finish(loop)
    found = replay(RecordingSource(tmp_path / "bag"))
    assert found.identical
    assert found.steps == len(loop.steps)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("elbow",), r"locked_joints has 'elbow', which is no joint of the arm; valid: panda_joint1, .*panda_joint7"),
        (("",), r"locked_joints has '', which is no joint"),
        (tuple(f"panda_joint{number}" for number in range(1, 8)), r"locked_joints has all 7 joints; valid: at most 6"),
        ("panda_joint1", r"locked_joints is 'panda_joint1' \(string\); valid: a list of strings"),
        ((1,), r"locked_joints is \[1\] \(list of integer\); valid: a list of strings"),
    ],
)
def test_wrong_names_are_refused_in_one_line(names: Any, words: str) -> None:
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.02)
    before = loop.controller.settings
    for change in (loop.controller.check, loop.controller.apply):
        with pytest.raises(SettingsError, match=words) as error:
            change(before.with_values({"locked_joints": names}))
        assert "\n" not in str(error.value)
    assert loop.controller.settings is before
    loop.run(0.02)
    assert loop.controller.status.level is Level.OK


def test_all_but_one_joint_may_be_locked() -> None:
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.05)
    locking(loop, *loop.robot.joints[1:])
    goal = loop.pose()
    goal[1, 3] += 0.1
    loop.run(0.5, lambda: loop.target(goal))
    moved: Array = loop.steps[-1].joint_position - READY["panda"]
    assert np.abs(moved[1:]).max() < ACCURACY
    assert abs(moved[0]) > 0.02

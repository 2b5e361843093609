"""Inverse kinematics with locked joints: they stay at the seed, the others reach the pose within their limits."""

from __future__ import annotations

import json
from math import inf

import numpy as np
import pytest
from arms import random_position
from loop import READY, make_robot

from ik_node.cli import solve as command
from ik_node.errors import InputError, SettingsError
from ik_node.inverse_kinematics.pose_solver import PoseSolver, solve_pose
from ik_node.inverse_kinematics.worked_examples import planar_2r
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance

POINTING = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf))


@pytest.mark.parametrize(("name", "joint", "task"), [("panda", 2, None), ("xarm7", 4, None), ("ur5", 0, POINTING)])
def test_poses_made_with_the_joint_at_the_seed_are_reached(name: str, joint: int, task: TaskTolerance | None) -> None:
    robot, rng = make_robot(name), np.random.default_rng(1)
    locked, tolerance = (robot.joints[joint],), task or TaskTolerance()
    solver, solved = PoseSolver(robot, locked=locked, tolerance=tolerance), 0
    for _ in range(30):
        q, seed = random_position(robot, rng), random_position(robot, rng)
        q[joint] = seed[joint]
        solution = solver.solve(robot.pose(q), seed)
        assert solution.q[joint] == seed[joint]
        assert all(entry.theta[joint] == seed[joint] for entry in solution.iterates)
        if solution.converged:
            solved += 1
            error = se3.log(se3.inverse(robot.pose(solution.q)) @ robot.pose(q))
            assert np.linalg.norm(error[:3]) < 2e-6
            assert ((solution.q >= robot.limits.lower - 1e-9) & (solution.q <= robot.limits.upper + 1e-9)).all()
    assert solved == 30


def test_a_pose_that_needs_the_joint_is_not_reached() -> None:
    robot, q = make_robot("ur5"), np.array(READY["ur5"])
    seed = q + 0.3
    assert not solve_pose(robot, robot.pose(q), seed, locked=("elbow_joint",)).converged
    assert solve_pose(robot, robot.pose(q), seed).converged


def test_wrong_arguments_are_refused_in_one_line() -> None:
    robot, q = make_robot("ur5"), np.array(READY["ur5"])
    pose = robot.pose(q)
    with pytest.raises(
        SettingsError, match=r"locked_joints has 'elbow', which is no joint of the arm; valid: shoulder"
    ):
        solve_pose(robot, pose, q, locked=("elbow",))
    with pytest.raises(SettingsError, match="locked_joints has all 6 joints"):
        solve_pose(robot, pose, q, locked=robot.joints)
    with pytest.raises(InputError, match="locked joints need a seed"):
        solve_pose(robot, pose, locked=("elbow_joint",))
    with pytest.raises(InputError, match="locked joints are given by name, which only a Robot has"):
        solve_pose(planar_2r().chain, np.eye(4), (0.0, 0.0), locked=("a",))


def test_the_command_line_locks_joints(capsys: pytest.CaptureFixture[str]) -> None:
    robot = make_robot("panda")
    q = np.array(READY["panda"])
    pose = robot.pose(q)
    numbers = [*pose[:3, 3], *se3.quaternion_from_rotation(pose[:3, :3])]
    seed = [*map(str, (q + 0.1).tolist())]
    target = " ".join(map(str, numbers))
    arguments = ["--robot", "panda", "--target", target, "--seed", *seed, "--lock", "panda_joint3", "--json"]
    assert command.main(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["q"][2] == float(seed[2])
    assert document["locked"] == ["panda_joint3"]
    assert command.main([*arguments[:-2], "elbow"]) == 2
    assert "error: locked_joints has 'elbow'" in capsys.readouterr().err
    assert command.main(["--robot", "panda", "--target", target, "--lock", "panda_joint3"]) == 2
    assert "error: --lock needs --seed, and cannot be used with --restarts 0" in capsys.readouterr().err
    assert command.main(["--example", "2r", "--lock", "a"]) == 2
    assert "error: --lock needs a robot; --example has none" in capsys.readouterr().err
    assert command.main(["--robot", "ur5", "--target", target, "--seed", *seed[:6], "--lock", "elbow_joint"]) == 1
    assert "hint: the arm can follow 5 of 6 exact components in general" in capsys.readouterr().err

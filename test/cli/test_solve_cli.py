"""`ik_solve`: its printed numbers are those of the library, documents are complete, pictures are written, exit codes
and messages state what is wrong. Other files test the mathematics."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ik_node.cli.solve import main
from ik_node.inverse_kinematics.newton_raphson import solve_pose_newton
from ik_node.inverse_kinematics.pose_solver import solve_pose
from ik_node.inverse_kinematics.worked_examples import planar_2r
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot

POSE = "0.4 0.1 0.5 1 0 0 0"
UR5 = ["--robot", "ur5", "--target", "-0.5 0.1 0.1 0.5 0.5 -0.5 0.5"]
SO101 = ["--robot", "so101", "--target", "0.25 0.1 0.1 0 0.8660254 0 0.5"]
SEED = ["--seed", "2.6", "0.6", "-1.7", "1.1", "-0.6", "-1.6"]


def document(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> Any:
    assert main([*arguments, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def test_example_2r_prints_the_table_of_the_notes(capsys: pytest.CaptureFixture[str]) -> None:
    # Rows 0, 1 and 3 as printed there; row 2 with the corrected -0.003 (the notes have -0.004).
    assert main(["--example", "2r"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.strip()[:1].isdigit()]
    assert rows == [
        ["0", "0.00", "30.00", "1.866", "0.500", "1.571", "0.498", "1.858", "1.571", "1.924"],
        ["1", "34.23", "79.18", "0.429", "1.480", "0.115", "-0.074", "0.108", "0.115", "0.131"],
        ["2", "29.98", "90.22", "0.363", "1.364", "-0.003", "0.000", "-0.003", "0.003", "0.004"],
        ["3", "30.00", "90.00", "0.366", "1.366", "0.000", "0.000", "0.000", "0.000", "0.000"],
    ]


def test_example_2r_document_holds_full_doubles(capsys: pytest.CaptureFixture[str]) -> None:
    result = document(capsys, "--example", "2r")
    solution = solve_pose_newton(*planar_2r())
    assert (result["converged"], result["reason"], result["total_iterations"]) == (True, "converged", 3)
    assert result["twist_order"] == ["v_x", "v_y", "v_z", "omega_x", "omega_y", "omega_z"]
    assert result["twist_frame"] == "body"
    assert result["q"] == solution.q.tolist()
    for row, iterate in zip(result["iterations"], solution.iterates, strict=True):
        assert row["theta"] == iterate.theta.tolist()
        assert row["twist"] == iterate.twist.tolist()
        assert (row["norm_omega"], row["norm_v"]) == (iterate.norm_omega, iterate.norm_v)
        assert row["position"] == iterate.pose_sb[:3, 3].tolist()


def test_plateau_shows_two_roots_and_the_failure(capsys: pytest.CaptureFixture[str]) -> None:
    result = document(capsys, "--example", "plateau")
    assert result["roots"] == [1.0, 3.0]
    outcomes = [(run["converged"], run["reason"]) for run in result["runs"]]
    assert outcomes == [(True, "converged"), (True, "converged"), (False, "diverged"), (False, "singular")]
    assert [run["q"][0] for run in result["runs"][:2]] == pytest.approx([3.0, 1.0], abs=1e-9)
    assert main(["--example", "plateau"]) == 0
    text = capsys.readouterr().out
    assert "not converged: diverged" in text
    assert "roots 1 and 3" in text
    chosen = document(capsys, "--example", "plateau", "--seed", "2.5")
    assert [run["start"] for run in chosen["runs"]] == [2.5]


def test_restarts_0_with_a_seed_is_pure_newton_raphson(capsys: pytest.CaptureFixture[str]) -> None:
    # The iterates of the library's full steps, in the body form and in the space form.
    arm = catalogue.find("ur5")
    robot = Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)
    pose = se3.pose_from([-0.5, 0.1, 0.1], [0.5, 0.5, -0.5, 0.5])
    start = np.array([float(text) for text in SEED[1:]])
    for form in ("body", "space"):
        solution = solve_pose_newton(robot, pose, start, eps_omega=1e-6, eps_v=1e-6, form=form)
        result = document(capsys, *UR5, *SEED, "--restarts", "0", "--form", form)
        assert [row["theta"] for row in result["iterations"]] == [row.theta.tolist() for row in solution.iterates]
        assert result["twist_frame"] == form
    assert result["joints"] == list(robot.joints)
    assert (result["base_frame"], result["tip_frame"]) == ("base_link", "tool0")


def test_search_within_limits(capsys: pytest.CaptureFixture[str]) -> None:
    arm = catalogue.find("panda")
    robot = Robot(catalogue.read_urdf(arm), arm.base_frame, arm.tip_frame)
    result = document(capsys, "--robot", "panda", "--target", POSE)
    reached = se3.log(se3.inverse(robot.pose(np.array(result["q"]))) @ se3.pose_from([0.4, 0.1, 0.5], [1, 0, 0, 0]))
    assert np.abs(reached).max() < 1e-6
    assert result["target"]["position"] == [0.4, 0.1, 0.5]
    assert (np.array(result["q"]) <= robot.limits.upper).all()
    other = document(capsys, "--robot", "panda", "--tip", "panda_link8", "--base", "panda_link0", "--target", POSE)
    assert other["tip_frame"] == "panda_link8"


def test_urdf_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(catalogue.read_urdf(catalogue.find("ur5")))
    named = document(capsys, *UR5, *SEED)
    read = document(capsys, "--urdf", str(path), "--base", "base_link", "--tip", "tool0", *UR5[2:], *SEED)
    assert named["iterations"] == read["iterations"]


def test_not_converged_is_said_and_the_exit_code_is_1(capsys: pytest.CaptureFixture[str]) -> None:
    out_of_reach = ["--robot", "ur5", "--target", "3 0 0 0 0 0 1"]
    assert main([*out_of_reach, "--max-iterations", "100"]) == 1
    assert "not converged: " in capsys.readouterr().out
    result = document(capsys, *out_of_reach, *SEED, "--restarts", "0", "--max-iterations", "7", code=1)
    assert (result["converged"], result["reason"]) == (False, "cap")
    assert len(result["iterations"]) == 8


def test_negative_and_exponent_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    # argparse alone interprets -1e-1 as an option.
    spelled = document(capsys, *UR5, "--seed", "2.6", "6e-1", "-17e-1", "1.1", "-6e-1", "-1.6", "--restarts", "0")
    together = document(capsys, *UR5, "--seed", "2.6, 0.6, -1.7, 1.1, -0.6, -1.6", "--restarts", "0")
    assert spelled["iterations"] == together["iterations"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--robot is missing"),
        (["--robot", "panda"], "--target is missing"),
        (["--robot", "no_such", "--target", POSE], "unknown robot 'no_such'; valid: "),
        (["--robot", "panda", "--tip", "no_such", "--target", POSE], "unknown frame 'no_such'; valid: "),
        (["--robot", "panda", "--base", "no_such", "--target", POSE], "unknown frame 'no_such'; valid: "),
        (["--robot", "panda", "--target", "0 0 0"], "--target has 3 numbers; expected 7"),
        (["--robot", "panda", "--target", "0 0 0 0 0 0 zero"], "expected numbers"),
        (["--robot", "panda", "--target", "0 0 0 0 0 0 nan"], "--target quaternion is not finite"),
        (["--robot", "panda", "--target", "0 0 0 0 0 0 0"], "norm 0"),
        (["--robot", "panda", "--target", "0 0 inf 0 0 0 1"], "--target position is not finite"),
        (["--robot", "panda", "--target", POSE, "--seed", "1", "2"], "--seed has shape (2,), expected (7,)"),
        (["--robot", "panda", "--target", POSE, "--eps-v", "-1"], "eps_v is -1.0"),
        (["--robot", "panda", "--target", POSE, "--restarts", "-1"], "restarts is -1"),
        (["--robot", "panda", "--target", POSE, "--max-iterations", "0"], "max_iterations is 0"),
        (["--urdf", "/no/such/file", "--target", POSE], "URDF file '/no/such/file' cannot be read"),
        (["--example", "2r", "--seed", "1"], "--seed has shape (1,), expected (2,)"),
        (["--example", "2r", "--plot", "/no/such/folder/x.png"], "the picture cannot be written"),
    ],
)
def test_bad_questions_are_named(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [["--example", "2r"], ["--example", "plateau"], [*UR5, *SEED], ["--robot", "panda", "--target", POSE]],
)
def test_pictures_are_written(arguments: list[str], tmp_path: Path) -> None:
    # Planar arm, scalar curve, spatial arms with a screw axis in the picture: as PNG and as valid SVG.
    for name, start in (("x.png", b"\x89PNG"), ("x.svg", b"<?xml")):
        path = tmp_path / name
        assert main([*arguments, "--plot", str(path)]) == 0
        assert path.read_bytes().startswith(start)
        assert path.stat().st_size > 10_000


def test_a_tolerance_solves_a_part_of_the_pose(capsys: pytest.CaptureFixture[str]) -> None:
    # Both spellings of the tolerance; the same solution as in the library; null stands for a free component.
    robot = catalogue.load_robot("so101")
    pose = se3.pose_from([0.25, 0.1, 0.1], np.array([0.0, 0.75**0.5, 0.0, 0.5]))
    free_yaw = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, np.inf), "base")
    words = document(capsys, *SO101, "--tolerance", "0", "0", "0", "0", "0", "inf", "--frame", "base")
    text = document(capsys, *SO101, "--tolerance", "0 0 0 0 0 inf", "--frame", "base")
    assert words == text
    assert (words["converged"], words["twist_frame"], words["frame"]) == (True, "base", "base")
    assert words["tolerance"] == [0.0, 0.0, 0.0, 0.0, 0.0, None]
    np.testing.assert_allclose(words["q"], solve_pose(robot, pose, tolerance=free_yaw).q, atol=1e-6)
    assert main([*SO101, "--tolerance", "0 0 0 0 0 inf", "--frame", "base"]) == 0
    printed = capsys.readouterr().out
    assert "tolerance 0 0 0 0 0 inf in the frame base" in printed
    assert "error (rx, ry, rz, x, y, z)" in printed


def test_what_an_arm_cannot_follow_is_named_with_a_proposal(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SO101, "--max-iterations", "300"]) == 1
    hint = capsys.readouterr().err.strip()
    assert hint.startswith("hint: the arm can follow 5 of 6 exact components in general; rz in the frame base")
    assert hint.endswith("proposed tolerance: 0 0 0 0 0 inf in the frame base")
    assert "\n" not in hint
    assert main(["--robot", "ur5", "--target", "3 0 0 0 0 0 1", "--max-iterations", "100"]) == 1
    assert capsys.readouterr().err == ""


def test_the_frame_of_a_tolerance_is_the_tool_by_default(capsys: pytest.CaptureFixture[str]) -> None:
    default = document(capsys, *UR5, *SEED, "--tolerance", "0 0 0 0 0 inf")
    assert default == document(capsys, *UR5, *SEED, "--tolerance", "0 0 0 0 0 inf", "--frame", "tool")
    assert default["searches"] >= 4


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([*UR5, "--tolerance", "0", "0"], "task tolerance has 2 numbers; expected 6: x y z rx ry rz"),
        ([*UR5, "--tolerance", "0 0 0 0 0 free"], "--tolerance is '0 0 0 0 0 free'; expected numbers"),
        ([*UR5, "--tolerance", "0", "0", "0", "-1e-3", "0", "0"], "task tolerance rx is -0.001"),
        ([*UR5, "--tolerance", "0 0 0 0 0 nan"], "task tolerance rz is nan"),
        ([*UR5, "--tolerance", "inf inf inf inf inf inf"], "all six components free"),
        ([*UR5, "--frame", "base"], "--frame has no effect without --tolerance"),
        ([*UR5, "--tolerance", "0 0 0 0 0 inf", "--restarts", "0"], "cannot be used with --restarts 0"),
        (["--example", "2r", "--tolerance", "0 0 0 0 0 inf"], "--tolerance and --frame need a robot"),
        (["--example", "plateau", "--frame", "tool"], "--tolerance and --frame need a robot"),
    ],
)
def test_bad_tolerances_are_named(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1

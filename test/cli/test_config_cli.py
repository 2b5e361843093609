"""``ik_config``: the printed file is accepted by node and simulated arm, and every value has its source."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import PROJECT

from ik_node.cli.config import main
from ik_node.math.task_tolerance import COMPONENTS, TaskTolerance
from ik_node.robot import catalogue
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.simulator_parameters import SIMULATOR, arm_settings, checked_values, start_position
from ik_node.robot.task_rank import task_rank
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_sections, read_settings, values_of

OWN = PROJECT / "test" / "lift_arm.urdf"


def written(urdf: Path, folder: Path, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[Path, str]:
    assert main([str(urdf), *options]) == 0
    text = capsys.readouterr().out
    path = folder / "arm.yaml"
    path.write_text(text)
    return path, text


def test_node_and_simulated_arm_accept_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, text = written(OWN, tmp_path, capsys)
    settings = read_settings(path)
    robot = robot_from_settings(settings.arm)
    assert robot.name == "lift_arm"
    assert robot.tip_frame == "grasp_point"
    assert robot.joints == settings.arm.joints == ("lift", "turn", "raise", "bend", "roll", "tilt", "spin")
    assert "left out as a gripper's: close" in text
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz)
    assert limits.velocity.tolist() == [0.25, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0]
    assert limits.acceleration.tolist() == [1.25, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0]
    assert limits.lower[0] == 0.0
    assert np.isinf(limits.lower[-1])

    values = checked_values(values_of(read_sections(path), SIMULATOR) or {})
    simulated = robot_from_settings(arm_settings(values))
    start = start_position(values, simulated.joints)
    assert start is not None
    assert simulated.joints == robot.joints
    assert (limits.lower < start).all()
    assert (start < limits.upper).all()
    assert np.linalg.svd(robot.evaluate(start).jacobian_b, compute_uv=False)[-1] > 0.1


def test_every_value_has_its_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, text = written(OWN, tmp_path, capsys)
    for line in (
        "- lift  # prismatic, 0 to 0.5 m: URDF",
        "- spin  # revolute, no position limits: URDF",
        "- 0.25  # lift, m/s: URDF",
        "- 1.25  # lift, m/s2: assumed",
        "# A URDF has no acceleration limits. Assumed:",
        "rate_hz: 500.0  # assumed",
    ):
        assert line in text
    assert "task:" not in text, "the arm can follow whole poses"
    assert "singularity:" not in text, "the default fits an arm of this size"


def test_limits_that_cannot_be_meant_are_assumed_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    urdf = tmp_path / "arm.urdf"
    text = OWN.read_text().replace('lower="-2.9" upper="2.9" velocity="2"', 'lower="0" upper="0" velocity="0"')
    urdf.write_text(text.replace('<limit effort="100" velocity="3"/>', ""))
    path, text = written(urdf, tmp_path, capsys)
    settings = read_settings(path)
    limits = motion_limits(robot_from_settings(settings.arm), settings.limits, settings.control.rate_hz)
    assert limits.velocity.tolist() == [0.25, 1.0, 2.0, 2.0, 3.0, 3.0, 1.0]
    assert (limits.lower[1], limits.upper[1]) == pytest.approx((-np.pi, np.pi), abs=1e-3)
    assert "turn, rad/s: assumed, the URDF has none" in text
    assert "turn: assumed; joint 'turn' has position limits 0 to 0 in the URDF" in text
    assert "spin: none in the URDF" in text


@pytest.mark.parametrize("name", ["so101", "so100"])
def test_an_arm_with_five_joints_gets_the_task_that_it_can_follow(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arm = catalogue.find(name)
    path, text = written(catalogue.robots_folder() / arm.urdf, tmp_path, capsys)
    settings = read_settings(path)
    assert len(settings.arm.joints) == 5
    assert settings.task.tolerance == (0.0, 0.0, 0.0, 0.0, 0.0, np.inf)
    assert settings.task.frame == "base"
    assert "rz in the frame base cannot be followed beside the others" in text
    assert followed(settings)
    assert settings.singularity.threshold == pytest.approx(0.02, abs=0.003), "0.12 m is more than this arm has anywhere"


def followed(settings: Settings) -> bool:
    """Whether the arm can follow all exact components of its task."""
    tolerance = TaskTolerance(settings.task.tolerance, settings.task.frame)
    return task_rank(robot_from_settings(settings.arm), tolerance).followed


def serial_urdf(*joints: str) -> str:
    """An arm of 0.2 m links along x; each joint is a type and an axis, ``revolute 0 0 1``."""
    text = '<robot name="small"><link name="link0"/>'
    for number, joint in enumerate((*joints, "fixed 1 0 0"), 1):
        kind, _, axis = joint.partition(" ")
        text += (
            f'<link name="link{number}"><inertial><mass value="0.5"/><origin xyz="0.1 0 0"/>'
            '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="joint{number}" type="{kind}"><parent link="link{number - 1}"/><child link="link{number}"/>'
            f'<origin xyz="{0.2 if number > 1 else 0.0} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-2.5" upper="2.5" velocity="1" effort="10"/></joint>'
        )
    return text + "</robot>"


@pytest.mark.parametrize(
    ("joints", "exact"),
    [
        (("revolute 0 0 1", "revolute 0 0 1", "revolute 0 0 1"), {"x", "y", "rz"}),
        (("revolute 0 0 1", "revolute 0 1 0", "revolute 0 1 0"), {"x", "y", "z"}),
        (("revolute 0 0 1", "revolute 0 0 1", "revolute 0 0 1", "prismatic 0 0 1"), {"x", "y", "z", "rz"}),
        (("revolute 0 0 1", "revolute 0 1 0", "revolute 0 1 0", "revolute 0 1 0"), {"x", "y", "z", "ry"}),
    ],
    ids=["planar 3R", "3R in space", "SCARA", "4R with a pitch"],
)
def test_arms_of_three_and_four_joints_get_a_task(
    joints: tuple[str, ...], exact: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = tmp_path / "small.urdf"
    urdf.write_text(serial_urdf(*joints))
    path, text = written(urdf, tmp_path, capsys)
    settings = read_settings(path)
    assert {name for name, width in zip(COMPONENTS, settings.task.tolerance, strict=True) if width == 0.0} == exact
    assert f"the arm can follow {len(joints)} of 6 exact components in general" in text
    assert followed(settings)


def test_frames_can_be_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, _ = written(OWN, tmp_path, capsys, "--base", "carriage", "--tip", "wrist_3")
    assert read_settings(path).arm.joints == ("turn", "raise", "bend", "roll", "tilt", "spin")


@pytest.mark.parametrize(
    ("content", "arguments", "reason"),
    [
        (None, (), "No such file"),
        (b"\xff\xfe\x00", (), "cannot be read"),
        (b"<sdf/>", (), "root element is <sdf>; expected <robot>"),
        (b'<robot name="a"><link name="b"/></robot>', (), "no movable joint"),
        (OWN.read_bytes(), ("--tip", "nowhere"), "unknown frame 'nowhere'; valid: base"),
    ],
)
def test_files_that_are_no_arm(
    content: bytes | None, arguments: tuple[str, ...], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm.urdf"
    if content is not None:
        path.write_bytes(content)
    assert main([str(path), *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == "", "an empty file is easier to notice than a part of one"
    assert reason in said.err
    assert len(said.err.splitlines()) == 1

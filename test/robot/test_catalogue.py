"""Loading of robots by name, from a file, and from text; error messages list what is valid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import PROJECT

from ik_node.errors import RobotError, UnknownNameError
from ik_node.robot import catalogue
from ik_node.robot.catalogue import load_robot
from ik_node.robot.joint_limits import urdf_limits
from ik_node.settings.groups import ArmSettings

URDF = catalogue.read_urdf(catalogue.find("panda"))


def test_a_robot_is_loaded_by_name_from_a_file_or_from_text(tmp_path: Path) -> None:
    named = load_robot("panda")
    assert (named.base_frame, named.tip_frame, named.n) == ("panda_link0", "panda_hand_tcp", 7)
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    for source in (file, str(file), URDF):
        loaded = load_robot(source, "panda_link0", "panda_hand_tcp")
        assert (loaded.pose(np.zeros(7)) == named.pose(np.zeros(7))).all()


def test_frames_and_joints_can_be_selected() -> None:
    part = load_robot("ur5", tip_frame="wrist_3_link", joints=["shoulder_pan_joint", "elbow_joint"], joint_prefix="a_")
    assert part.joints == ("a_shoulder_pan_joint", "a_elbow_joint")
    assert (part.base_frame, part.tip_frame) == ("base_link", "wrist_3_link")


@pytest.mark.parametrize(
    ("source", "error", "text"),
    [
        ("pandora", UnknownNameError, r"unknown robot 'pandora'; valid: kinova, .*xarm7, z1 \(configured\); .*a1, "),
        ("nowhere/arm.urdf", RobotError, r"nowhere/arm.urdf' cannot be read: No such file.*valid: .*panda"),
        (Path("arm"), RobotError, r"'arm' cannot be read: No such file"),
        ("<robot/>", RobotError, "not a valid URDF"),
    ],
)
def test_errors_list_what_is_valid(source: str | Path, error: type[RobotError], text: str) -> None:
    with pytest.raises(error, match=text):
        load_robot(source)


def test_a_limit_of_zero_in_a_urdf_is_no_limit() -> None:
    limits = urdf_limits(np.array([-1.0, 0.0, 1.0]), np.array([1.0, 0.0, -1.0]), np.array([2.0, 0.0, -1.0]))
    assert limits.lower.tolist() == [-1.0, -np.inf, -np.inf]
    assert limits.upper.tolist() == [1.0, np.inf, np.inf]
    assert limits.velocity.tolist() == [2.0, np.inf, np.inf]


def test_the_configured_robots_are_those_with_a_parameter_file() -> None:
    assert {path.stem for path in (PROJECT / "config").glob("*.yaml")} == catalogue.ARMS.keys()


def test_a_description_may_be_the_path_of_a_file(tmp_path: Path) -> None:
    file = tmp_path / "my arm.urdf"
    file.write_text(URDF)
    robot = catalogue.robot_from_settings(ArmSettings(robot_description=str(file)))
    assert (robot.name, robot.tip_frame, robot.n) == ("panda", "panda_hand_tcp", 7)
    for wrong, reason in ((tmp_path, "Is a directory"), (tmp_path / "absent", "No such file"), (__file__, "not XML")):
        with pytest.raises(RobotError, match=reason):
            catalogue.robot_from_settings(ArmSettings(robot_description=str(wrong)))


def test_an_endless_file_is_no_urdf() -> None:
    with pytest.raises(RobotError, match="more than 2000000 bytes"):
        catalogue.read_file("/dev/zero")

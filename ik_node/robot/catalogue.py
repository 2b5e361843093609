"""Robots by name: the arms of example-robot-data, wherever it is installed (PyPI wheel or ROS package)."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from ik_node.errors import RobotError, UnknownNameError
from ik_node.robot.robot import Robot
from ik_node.robot.tool import with_tool
from ik_node.settings.groups import ArmSettings


class Arm(NamedTuple):
    """Where an arm's URDF lies in example-robot-data, and its usual base and tool frames."""

    urdf: str
    base_frame: str
    tip_frame: str
    srdf: str = ""
    """SRDF inside the URDF's package; empty: srdf/ with the URDF's file name."""


ARMS = {
    "kinova": Arm("kinova_description/robots/kinova.urdf", "j2s6s200_link_base", "j2s6s200_end_effector"),
    "panda": Arm("panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp"),
    "talos_arm": Arm(
        "talos_data/robots/talos_left_arm.urdf", "arm_left_1_link", "wrist_left_ft_tool_link", "srdf/talos.srdf"
    ),
    "ur10": Arm("ur_description/urdf/ur10_robot.urdf", "base_link", "tool0"),
    "ur3": Arm("ur_description/urdf/ur3_robot.urdf", "base_link", "tool0"),
    "ur5": Arm("ur_description/urdf/ur5_robot.urdf", "base_link", "tool0", "srdf/ur5.srdf"),
    "xarm7": Arm("xarm_description/urdf/xarm7.urdf", "link_base", "link_eef"),
    "z1": Arm("z1_description/urdf/z1.urdf", "link00", "link06"),
}
"""Arms with frames of their own; any other URDF of example-robot-data is found by its file's name."""


def robots_folder() -> Path:
    """The folder ``robots`` of example-robot-data; RobotError with the places looked at when it is not installed."""
    looked = []
    for place in _places():
        if place.is_dir():
            return place
        looked.append(str(place))
    raise RobotError(f"example-robot-data is not installed; looked in {', '.join(looked)}")


def _places() -> Iterator[Path]:
    inside = Path("share/example-robot-data/robots")
    with contextlib.suppress(metadata.PackageNotFoundError):
        yield Path(str(metadata.distribution("example-robot-data").locate_file("cmeel.prefix"))) / inside
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        if prefix:
            yield Path(prefix) / inside


def find(name: str) -> Arm:
    """The arm called ``name``: one of :data:`ARMS`, else the URDF of that file name.

    Raises UnknownNameError with every name that works.
    """
    if name in ARMS:
        return ARMS[name]
    root = robots_folder()
    files = {path.stem: str(path.relative_to(root)) for path in sorted(root.rglob("*.urdf"))}
    if name not in files:
        raise UnknownNameError("robot", name, {*ARMS, *files})
    return Arm(files[name], "", "")


def read_urdf(arm: Arm) -> str:
    """The URDF of ``arm`` as text."""
    return (robots_folder() / arm.urdf).read_text()


def robot_from(arm: ArmSettings, described: str = "") -> Robot:
    """The robot that ``arm`` names; ``described`` is a URDF that came on the topic robot_description.

    The parameter robot_description goes before ``robot``, and both before the topic. Raises RobotError when there is
    neither, and as :class:`ik_node.robot.robot.Robot` and :func:`find` do.
    """
    urdf, base_frame, tip_frame = arm.robot_description or described, arm.base_frame, arm.tip_frame
    if arm.robot and not arm.robot_description:
        known = find(arm.robot)
        urdf = read_urdf(known)
        base_frame, tip_frame = base_frame or known.base_frame, tip_frame or known.tip_frame
    if not urdf:
        raise RobotError("no robot: set `robot` or `robot_description`, or publish the topic robot_description")
    robot = Robot(urdf, base_frame, tip_frame, arm.joints, arm.joint_prefix)
    if not arm.tool_offset:
        return robot
    changed = with_tool(urdf, robot.tip_frame, arm.tool_offset)
    return Robot(changed.urdf, base_frame, changed.tip_frame, arm.joints, arm.joint_prefix)

"""Robots by name (example-robot-data, from its PyPI wheel or ROS package), by URDF file, or by URDF text."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from ik_node.errors import RobotError, UnknownNameError
from ik_node.robot.description import MAX_CHARACTERS
from ik_node.robot.robot import Robot
from ik_node.robot.tool import with_tool
from ik_node.settings.groups import ArmSettings


class CatalogueEntry(NamedTuple):
    """URDF of an arm in example-robot-data, and its usual base and tool frames."""

    urdf: str
    base_frame: str
    tip_frame: str
    srdf: str = ""
    """SRDF inside the URDF's package; empty: srdf/ with the file name of the URDF."""


ARMS = {
    "kinova": CatalogueEntry("kinova_description/robots/kinova.urdf", "j2s6s200_link_base", "j2s6s200_end_effector"),
    "panda": CatalogueEntry("panda_description/urdf/panda.urdf", "panda_link0", "panda_hand_tcp"),
    "so100": CatalogueEntry("so_arm_description/urdf/so100.urdf", "base", "gripper"),
    "so101": CatalogueEntry("so_arm_description/urdf/so101.urdf", "base_link", "gripper_frame_link"),
    "talos_arm": CatalogueEntry(
        "talos_data/robots/talos_left_arm.urdf", "arm_left_1_link", "wrist_left_ft_tool_link", "srdf/talos.srdf"
    ),
    "ur10": CatalogueEntry("ur_description/urdf/ur10_robot.urdf", "base_link", "tool0"),
    "ur3": CatalogueEntry("ur_description/urdf/ur3_robot.urdf", "base_link", "tool0"),
    "ur5": CatalogueEntry("ur_description/urdf/ur5_robot.urdf", "base_link", "tool0", "srdf/ur5.srdf"),
    "xarm7": CatalogueEntry("xarm_description/urdf/xarm7.urdf", "link_base", "link_eef"),
    "z1": CatalogueEntry("z1_description/urdf/z1.urdf", "link00", "link06"),
}
"""Arms with predefined frames; all other URDFs of example-robot-data are found by file name."""


def robots_folder() -> Path:
    """Returns the folder ``robots`` of example-robot-data.

    Raises:
        RobotError: example-robot-data is not installed; lists the folders that were searched.
    """
    searched = []
    for folder in _candidates():
        if folder.is_dir():
            return folder
        searched.append(str(folder))
    raise RobotError(f"example-robot-data is not installed; searched {', '.join(searched)}")


def _candidates() -> Iterator[Path]:
    inside = Path("share/example-robot-data/robots")
    with contextlib.suppress(metadata.PackageNotFoundError):
        yield Path(str(metadata.distribution("example-robot-data").locate_file("cmeel.prefix"))) / inside
    for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix):
        if prefix:
            yield Path(prefix) / inside


def find(name: str) -> CatalogueEntry:
    """Finds a robot of example-robot-data.

    Args:
        name: A key of :data:`ARMS`, or the name of a URDF file without its suffix.

    Returns:
        The entry; its frames are empty for robots outside :data:`ARMS`.

    Raises:
        UnknownNameError: There is no robot of this name; lists the valid names.
        RobotError: example-robot-data is not installed.
    """
    if name in ARMS:
        return ARMS[name]
    root = robots_folder()
    files = {path.stem: str(path.relative_to(root)) for path in sorted(root.rglob("*.urdf"))}
    if name not in files:
        raise UnknownNameError("robot", name, {*ARMS, *files}, ARMS)
    return CatalogueEntry(files[name], "", "")


def read_urdf(arm: CatalogueEntry) -> str:
    """Text of the URDF of ``arm``."""
    return (robots_folder() / arm.urdf).read_text()


def read_file(path: str | Path) -> str:
    """Text of a URDF file.

    Args:
        path: The file; ``~`` is the user's home.

    Raises:
        RobotError: The file cannot be read, is too large, or is no text; names it.
    """
    try:
        with Path(path).expanduser().open("rb") as file:
            data = file.read(MAX_CHARACTERS + 1)
        if len(data) > MAX_CHARACTERS:
            raise ValueError(f"it has more than {MAX_CHARACTERS} bytes")
        return data.decode()
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: ~ of an unknown user
        reason = getattr(error, "strerror", None) or str(error)
        raise RobotError(f"URDF file '{path}' cannot be read: {reason}") from error


def load_robot(
    source: str | Path, base_frame: str = "", tip_frame: str = "", joints: Sequence[str] = (), joint_prefix: str = ""
) -> Robot:
    """Loads a robot by name, from a URDF file, or from the text of a URDF.

    Args:
        source: Name of a robot in example-robot-data (for example "panda", see :data:`ARMS`), path of a URDF file, or
            text of a URDF.
        base_frame: Frame {s}; default: the usual base frame of a named robot, else the root of the model.
        tip_frame: Tool frame {b}; default: the usual tool frame of a named robot, else the end of the longest chain.
        joints: Controlled joints in order; default: every movable joint between base and tip.
        joint_prefix: Prefix of the joint names in :attr:`Robot.joints`.

    Returns:
        The robot.

    Raises:
        UnknownNameError: There is no robot, frame or joint of this name; lists the valid names.
        RobotError: The file cannot be read, the URDF is invalid, or there is no joint to control.
    """
    text = str(source)
    if text.lstrip().startswith("<"):
        return Robot(text, base_frame, tip_frame, tuple(joints), joint_prefix)
    if isinstance(source, Path) or "/" in text or text.endswith((".urdf", ".xml")):
        try:
            urdf = read_file(text)
        except RobotError as error:
            names = ", ".join(sorted(ARMS))
            raise RobotError(
                f"{error}; valid: path of a URDF file, URDF text, "
                f"or the name of a robot in example-robot-data ({names}, ...)"
            ) from error
        return Robot(urdf, base_frame, tip_frame, tuple(joints), joint_prefix)
    entry = find(text)
    return Robot(
        read_urdf(entry), base_frame or entry.base_frame, tip_frame or entry.tip_frame, tuple(joints), joint_prefix
    )


def robot_from_settings(arm: ArmSettings, described: str = "") -> Robot:
    """Loads the robot that the settings select.

    Args:
        arm: Settings. ``robot_description``, text or path, takes precedence over ``robot``, and both over
            ``described``.
        described: URDF from the topic robot_description, or empty.

    Returns:
        The robot, with the link of ``tool_offset`` if that is set.

    Raises:
        UnknownNameError: There is no robot, frame or joint of this name; lists the valid names.
        RobotError: No robot is selected, the URDF is invalid, or there is no joint to control.
        InputError: ``tool_offset`` is not a pose.
    """
    urdf, base_frame, tip_frame = arm.robot_description or described, arm.base_frame, arm.tip_frame
    if urdf.strip() and "<" not in urdf:
        urdf = read_file(urdf)
    if arm.robot and not arm.robot_description:
        entry = find(arm.robot)
        urdf = read_urdf(entry)
        base_frame, tip_frame = base_frame or entry.base_frame, tip_frame or entry.tip_frame
    if not urdf:
        raise RobotError("no robot: set `robot` or `robot_description`, or publish the topic robot_description")
    robot = Robot(urdf, base_frame, tip_frame, arm.joints, arm.joint_prefix)
    if not arm.tool_offset:
        return robot
    changed = with_tool(urdf, robot.tip_frame, arm.tool_offset)
    return Robot(changed.urdf, base_frame, changed.tip_frame, arm.joints, arm.joint_prefix)

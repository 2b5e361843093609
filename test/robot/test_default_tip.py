"""The default tool frame: no joint of a gripper takes part in the motion of an arm."""

from __future__ import annotations

import pytest

from ik_node.robot.catalogue import find, load_robot, read_urdf
from ik_node.robot.robot import Robot

LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
ARM = tuple((f"joint{index}", "revolute", f"link{index - 1}", f"link{index}") for index in range(1, 7))
TOOL = ("tool_fixed", "fixed", "link6", "tool")


def urdf(*joints: tuple[str, ...], mimic: str = "") -> str:
    """Arm of ``joints`` (name, type, parent, child); those whose names end in "mimic" mimic ``mimic``."""
    links = dict.fromkeys(link for joint in joints for link in joint[2:4])
    text = "".join(f'<link name="{link}"/>' for link in links)
    for name, kind, parent, child in joints:
        coupled = f'<mimic joint="{mimic}"/>' if name.endswith("mimic") else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        text += f'<joint name="{name}" type="{kind}">{ends}<axis xyz="0 0 1"/>{LIMIT}{coupled}</joint>'
    return f'<robot name="own">{text}</robot>'


@pytest.mark.parametrize(
    ("gripper", "mimic", "left_out", "tip"),
    [
        ([("opening", "revolute", "tool", "part")], "", (), "part"),
        ([("gripper", "revolute", "tool", "jaw")], "", ("gripper",), "tool"),
        ([("LeftFinger", "prismatic", "tool", "part")], "", ("LeftFinger",), "tool"),
        ([("opening", "revolute", "tool", "moving_jaw")], "", ("opening",), "tool"),
        ([("opening", "revolute", "link6", "part")], "", ("opening",), "tool"),
        ([("gripper_roll", "revolute", "link6", "palm"), ("lock", "fixed", "palm", "end")], "", (), "end"),
        ([("a", "prismatic", "tool", "p1"), ("b", "prismatic", "tool", "p2")], "", ("a",), "tool"),
        ([("a", "prismatic", "tool", "p1"), ("b_mimic", "prismatic", "tool", "p2")], "a", ("a",), "tool"),
        (
            [(f"{f}{n}", "revolute", f"{f}{n - 1}" if n else "tool", f"{f}{n}") for f in "kms" for n in range(4)],
            "",
            ("k0", "k1", "k2", "k3"),
            "tool",
        ),
    ],
)
def test_joints_of_a_gripper_are_left_out(
    gripper: list[tuple[str, ...]], mimic: str, left_out: tuple[str, ...], tip: str
) -> None:
    tool = () if any(joint[0] == "gripper_roll" for joint in gripper) else (TOOL,)
    robot = Robot(urdf(*ARM, *tool, *gripper, mimic=mimic))
    assert robot.gripper == left_out
    assert robot.tip_frame == tip
    assert set(robot.joints).isdisjoint(left_out)
    assert robot.joints[:6] == tuple(joint[0] for joint in ARM)
    if left_out:
        assert f"left out as a gripper's: {', '.join(left_out)}" in robot.default_tip_text


def test_joints_that_mimic_joints_of_the_arm_belong_to_it() -> None:
    """A parallelogram: joint3 mimics joint2."""
    joints = [(f"{name}_mimic" if name == "joint6" else name, *rest) for name, *rest in ARM]
    robot = Robot(urdf(*joints, TOOL, mimic="joint5"))
    assert robot.gripper == ()
    assert robot.tip_frame == "tool"


def test_a_torso_with_a_head_keeps_its_arm() -> None:
    head = [("pan", "revolute", "link1", "neck"), ("tilt", "revolute", "neck", "head")]
    arm = [(name, kind, "link1" if parent == "link1" else parent, child) for name, kind, parent, child in ARM]
    robot = Robot(urdf(*arm, TOOL, *head))
    assert robot.joints == tuple(joint[0] for joint in ARM)


def test_a_hand_without_an_arm_keeps_its_joints() -> None:
    fingers = [(f"finger{n}", "revolute", f"finger{n - 1}" if n else "palm", f"finger{n}") for n in range(3)]
    assert Robot(urdf(*fingers)).n == 3


@pytest.mark.parametrize(
    ("name", "tip", "left_out"),
    [
        ("panda", "panda_hand_tcp", "panda_finger_joint1"),
        ("so100", "gripper", "gripper"),
        ("so101", "gripper_frame_link", "gripper"),
        ("z1", "gripperStator", "jointGripper"),
        ("pr2", "l_gripper_tool_frame", "l_gripper_l_finger_joint"),
        ("tiago", "hand_tool_link", "hand_index_abd_joint"),
        ("baxter", "left_gripper", "l_gripper_l_finger_joint"),
        ("ur5", "tool0", ""),
        ("xarm7", "link_eef", ""),
    ],
)
def test_known_arms(name: str, tip: str, left_out: str) -> None:
    robot = Robot(read_urdf(find(name)))
    assert robot.tip_frame == tip
    assert robot.gripper[:1] == ((left_out,) if left_out else ())


def test_a_tool_frame_that_is_given_is_used() -> None:
    given = load_robot("panda", tip_frame="panda_leftfinger")
    assert given.joints[-1] == "panda_finger_joint1"
    assert given.gripper == ()

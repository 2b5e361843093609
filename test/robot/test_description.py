"""Descriptions: what is not a tree of links with finite numbers is refused by name, before Pinocchio sees it.

Tested: one fault each, by the name in the error; thousands of seeded mutations of a URDF, each of which either gives a
robot whose kinematics are finite or a RobotError in one line. Not tested: the syntax of numbers, which is urdfdom's.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable

import numpy as np
import pytest
from arms import random_position

from ik_node.errors import RobotError
from ik_node.robot import catalogue
from ik_node.robot.description import MAX_CHARACTERS, MAX_DEPTH, MAX_LINKS, read_description
from ik_node.robot.robot import Robot
from ik_node.robot.tool import with_tool

LIMIT = '<limit lower="-2" upper="2" velocity="2" effort="9"/>'
INERTIAL = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
GAZEBO = '<gazebo><controller:p3d name="p"><interface:position name="q"/></controller:p3d></gazebo>'
FOLLOWS = '<mimic joint="joint2" multiplier="-1"/>'


def joint(name: str, parent: str, child: str, kind: str = "fixed", inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.1 0 0.2" rpy="0 0.1 0"/>{inside}</joint>'
    )


def arm(extra: str = "", head: str = '<robot name="arm">', mimic: str = "", inertial: str = INERTIAL) -> str:
    """Six revolute joints in a row, joint1 to joint6, from base to link6, and a tool fixed to it."""
    parts = [head, '<link name="base"/>']
    for number, axis in enumerate(AXES, 1):
        parent, inside = ("base" if number == 1 else f"link{number - 1}"), f'<axis xyz="{axis}"/>{LIMIT}'
        parts.append(f'<link name="link{number}">{inertial}</link>')
        parts.append(
            joint(f"joint{number}", parent, f"link{number}", "revolute", inside + (mimic if number == 3 else ""))
        )
    return "\n".join([*parts, '<link name="tool"/>', joint("tool_joint", "link6", "tool"), extra, "</robot>"])


FAULTS: dict[str, tuple[str, str]] = {
    "a loop": (arm(joint("closing", "tool", "link2")), r"link 'link2' has two parents: joints 'joint2', 'closing'"),
    "a loop, other order": (arm(joint("a", "tool", "link2")), r"link 'link2' has two parents: joints 'joint2', 'a'"),
    "a loop with the root": (
        arm(joint("closing", "tool", "base")),
        r"links 'base', 'tool', 'link6', 'link5', 'link4', 'link3' and 2 more form a loop: joints 'closing', 'tool_",
    ),
    "a loop apart": (
        arm('<link name="x"/><link name="y"/>' + joint("xy", "x", "y") + joint("yx", "y", "x")),
        r"links 'x', 'y' form a loop: joints 'yx', 'xy'",
    ),
    "a link that is its own parent": (
        arm('<link name="x"/>' + joint("xx", "x", "x")), r"links 'x' form a loop: joints 'xx'"),
    "a diamond": (
        arm('<link name="x"/>' + joint("jx", "base", "x") + joint("xt", "x", "tool")),
        r"link 'tool' has two parents: joints 'tool_joint', 'xt'",
    ),
    "two joints between two links": (
        arm(joint("again", "link6", "tool")), r"link 'tool' has two parents: joints 'tool_joint', 'again'"),
    "two roots": (arm('<link name="stray"/>'), r"links 'base', 'stray' have no parent joint; expected one root link"),
    "no parent": (arm(joint("j", "nowhere", "tool")), r"joint 'j' has the parent link 'nowhere', which does not exist"),
    "no child": (arm(joint("j", "tool", "nowhere")), r"joint 'j' has the child link 'nowhere', which does not exist"),
    "no child at all": (arm('<joint name="j" type="fixed"><parent link="tool"/></joint>'), r"'j' has no child link"),
    "a link twice": (arm('<link name="link3"/>'), r"link name 'link3' occurs 2 times"),
    "a joint twice": (
        arm('<link name="x"/>' + joint("joint3", "tool", "x")), r"joint name 'joint3' occurs 2 times"),
    "a link without name": (arm("<link/>"), r"link number 9 has no name"),
    "an unknown type": (arm().replace('"revolute"', '"rotary"', 1), r"joint 'joint1' has type 'rotary'; valid: revo"),
    "a zero axis": (arm().replace('xyz="0 1 0"', 'xyz="0 0 0"', 1), r"joint 'joint2' has the axis '0 0 0'"),
    "an axis without numbers": (arm().replace('axis xyz="0 1 0"', "axis", 1), r"'joint2' has an <axis> without xyz"),
    "a tiny axis": (arm().replace('xyz="0 1 0"', 'xyz="0 1e-200 0"', 1), r"joint 'joint2' has the axis '0 1e-200 0'"),
    "a huge axis": (arm().replace('xyz="0 1 0"', 'xyz="0 1e200 0"', 1), r"joint 'joint2' has xyz '0 1e200 0' in <axis"),
    "an axis of nan": (arm().replace('xyz="0 1 0"', 'xyz="0 nan 0"', 1), r"joint 'joint2' has xyz '0 nan 0' in <axis>"),
    "an infinite origin": (
        arm().replace('xyz="0.1 0 0.2"', 'xyz="0.1 1e999 0"', 1),
        r"joint 'joint1' has xyz '0.1 1e999 0' in <origin>; expected finite numbers up to 1e\+09",
    ),
    "an infinite limit": (
        arm().replace('upper="2"', 'upper="inf"', 1),
        r"joint 'joint1' has upper 'inf' in <limit>; expected finite numbers",
    ),
    "a mass of nan": (arm().replace('mass value="1"', 'mass value="nan"', 1), r"link1' has value 'nan' in <mass>"),
    "an inertia of inf": (arm().replace('ixy="0"', 'ixy="-inf"', 1), r"link 'link1' has ixy '-inf' in <inertia>"),
    "a geometry of nan": (
        arm('<link name="x"><collision><geometry><sphere radius="nan"/></geometry></collision></link>'
            + joint("j", "tool", "x")),
        r"link 'x' has radius 'nan' in <sphere>",
    ),
    "a mimic joint of itself": (arm(mimic='<mimic joint="joint3"/>'), r"joint 'joint3' mimics itself in a circle"),
    "a mimic joint of nobody": (arm(mimic='<mimic joint="j"/>'), r"joint 'joint3' mimics 'j', which does not exist"),
    "a number that is none": (arm().replace('xyz="0 1 0"', 'xyz="0 ${a} 0"', 1), r"axis element for joint \[joint2\]"),
    "a comma": (arm().replace('xyz="0.1 0 0.2"', 'xyz="0,1 0 0"', 1), r"Malformed parent origin element for joint"),
    "no robot name": (arm(head="<robot>"), "No name given for the robot"),
    "not closed": (arm()[:-9], "not XML: "),
    "html": ("<html><body>no</body></html>", r"its root element is <html>; expected <robot>"),
    "empty": (" \n", "it is empty"),
    "xacro": (arm('<xacro:include filename="hand.xacro"/>'), r"it is a xacro file \(<xacro:include>\)"),
    "no links": ('<robot name="arm"/>', "it has 0 links"),
    "entities": ('<!DOCTYPE robot [<!ENTITY a "b">]>' + arm(), "it declares the entity 'a'"),
    "a surrogate": (arm('<link name="\ud800"/>'), "not XML: "),
    "a zero byte": (arm("\0"), "not XML: "),
    "too long": (arm("<!--" + MAX_CHARACTERS * "x" + "-->"), f"expected at most {MAX_CHARACTERS}"),
    "too deep": (arm(MAX_DEPTH * "<gazebo>" + MAX_DEPTH * "</gazebo>"), f"nested more than {MAX_DEPTH} levels"),
    "too many links": (arm("".join(f'<link name="x{i}"/>' for i in range(MAX_LINKS))), f"expected 1 to {MAX_LINKS}"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_a_broken_description_is_refused_with_the_name(fault: str, capfd: pytest.CaptureFixture[str]) -> None:
    urdf, reason = FAULTS[fault]
    with pytest.raises(RobotError, match=reason) as caught:
        Robot(urdf, tip_frame="tool")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == "", "the reason is in the error, not beside it"


def test_tool_and_base_exchanged_are_named() -> None:
    with pytest.raises(RobotError, match=r"'tool' is not between .* 'base': .*exchange base frame and tip frame"):
        Robot(arm(), "tool", "base")


SAME: dict[str, Callable[[str], str]] = {
    "undeclared prefixes": lambda urdf: urdf.replace("</robot>", GAZEBO + "</robot>"),
    "a default namespace": lambda urdf: urdf.replace("<robot ", '<robot xmlns="http://www.ros.org" '),
    "a prefix": lambda urdf: re.sub(r"(</?)(\w)", r"\1u:\2", urdf).replace("<u:robot ", '<u:robot xmlns:u="urn:u" '),
    "a declaration": lambda urdf: '\n<?xml version="1.0" encoding="UTF-16"?>\n' + urdf,
    "a byte order mark": lambda urdf: '\ufeff<?xml version="1.0"?>' + urdf,
    "a comment at the end": lambda urdf: urdf + "<!-- </robot> -->",
    "a fixed joint with axis zero": lambda urdf: urdf.replace('type="fixed">', 'type="fixed"><axis xyz="0 0 0"/>'),
    "foreign elements": lambda urdf: urdf.replace("</robot>", '<x:joint name="joint1" value="nan"/></robot>'),
}


@pytest.mark.parametrize("form", SAME)
def test_one_reading_for_links_and_mimic_joints(form: str) -> None:
    """The mimic joint is one in every form of the XML, and a tool can be added to each."""
    plain, other = arm(mimic=FOLLOWS), SAME[form](arm(mimic=FOLLOWS))
    robot, same = Robot(plain, tip_frame="tool"), Robot(other, tip_frame="tool")
    assert same.joints == robot.joints == ("joint1", "joint2", "joint4", "joint5", "joint6")
    q = np.linspace(-0.4, 0.5, 5)
    assert (robot.pose(q) == same.pose(q)).all()
    tooled = with_tool(other, "tool", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0))
    moved = Robot(tooled.urdf, tip_frame=tooled.tip_frame).pose(q)
    assert moved[:3, 3] == pytest.approx((robot.pose(q) @ (0.0, 0.0, 0.1, 1.0))[:3])


def test_the_joint_records_are_those_of_the_file() -> None:
    found = read_description(arm())
    assert list(found.joints) == [*(f"joint{i}" for i in range(1, 7)), "tool_joint"]
    assert found.joints["joint2"][:4] == ("joint2", "revolute", "link1", "link2")
    assert found.joints["joint2"].limit == {"lower": "-2", "upper": "2", "velocity": "2", "effort": "9"}
    assert found.joints["tool_joint"].limit is None
    assert found.masses == {"base": 0.0, **{f"link{i}": 1.0 for i in range(1, 7)}, "tool": 0.0}


def test_a_negative_effort_does_not_matter() -> None:
    found = read_description(arm().replace('effort="9"', 'effort="-1"', 1))
    assert found.joints["joint1"].limit == {"lower": "-2", "upper": "2", "velocity": "2", "effort": "-1"}
    assert Robot(arm().replace('effort="9"', 'effort="-1"', 1), tip_frame="tool").n == 6


# --- mutations ---

VALUES = ("nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "0", "-1", "0 0 0", "1e9 1e9 1e9", "", "x", "0 0",
          "0 0 0 0", "link1", "link3", "base", "tool", "joint2", "fixed", "floating", "planar", "continuous",
          "prismatic", "9" * 400,
          "\ufffe", "ä", "&#0;", "&lt;", "%s")  # fmt: skip


def mutated(rng: random.Random, urdf: str) -> str:
    """One to three mutations: of an attribute's value, of a line, or of a character."""
    for _ in range(rng.randint(1, 3)):
        lines = urdf.split("\n")
        kind = rng.choice((0, 0, 1, 1, 2, 3, 4, 5))
        at = rng.randrange(len(lines))
        if kind == 0:  # another value
            values = list(re.finditer(r'"[^"]*"', urdf))
            if values:
                hit = rng.choice(values)
                urdf = f'{urdf[: hit.start()]}"{rng.choice(VALUES)}"{urdf[hit.end() :]}'
            continue
        if kind == 1:  # the value of another attribute
            values = list(re.finditer(r'"[^"]*"', urdf))
            if values:
                hit = rng.choice(values)
                urdf = urdf[: hit.start()] + rng.choice(values)[0] + urdf[hit.end() :]
            continue
        if kind == 2:  # a character
            spot = rng.randrange(len(urdf) + 1)
            urdf = urdf[:spot] + rng.choice("<>\"'/= 0-\0é&;:") + urdf[spot + rng.randint(0, 1) :]
            continue
        if kind == 3:  # a line less
            del lines[at]
        elif kind == 4:  # a line twice
            lines.insert(rng.randrange(len(lines)), lines[at])
        else:  # two lines exchanged
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        urdf = "\n".join(lines)
    return urdf


def _try(urdf: str, rng: np.random.Generator) -> str:
    """The error of a description; empty for a robot, whose kinematics must be finite."""
    try:
        robot = Robot(urdf)
    except RobotError as error:
        return str(error)
    for _ in range(2):
        found = robot.evaluate(random_position(robot, rng))
        assert np.isfinite(found.pose_sb).all(), urdf
        assert np.isfinite(found.jacobian_b).all(), urdf
        rotation = found.pose_sb[:3, :3]
        assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-9, urdf
    return ""


@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.exhaustive) for part in range(1, 20))])
def test_no_mutation_crashes_or_gives_a_robot_that_is_not_finite(part: int) -> None:
    rng, numbers = random.Random(part), np.random.default_rng(part)
    finger = '<link name="finger"/>' + joint("slide", "tool", "finger", "prismatic", f'<axis xyz="0 1 0"/>{LIMIT}')
    start = arm(finger, mimic=FOLLOWS)
    refused = 0
    for _ in range(1000):
        error = _try(mutated(rng, start), numbers)
        assert "\n" not in error
        refused += bool(error)
    assert 100 < refused < 900


def test_the_robots_of_example_robot_data_stay_readable() -> None:
    """Every URDF that urdfdom reads passes the checks."""
    root, read = catalogue.robots_folder(), 0
    for path in sorted(root.rglob("*.urdf")):
        text = path.read_text()
        if "<link" in text:
            read_description(text)
            read += 1
    assert read > 60

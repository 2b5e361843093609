"""Broken descriptions of a robot.

``ik_solve --urdf`` refuses each in one line. A node that receives them on ``robot_description`` stays alive, logs why,
and takes the next good one.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from command_lines import one_line
from fault import choose
from fault_table import Row, failures
from ros_peer import peer_in_own_domain, rclpy

from ik_node.ros import qos

if rclpy:
    from std_msgs.msg import String

AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0", "0 0 1")
LIMIT = '<limit lower="-2.9" upper="2.9" effort="50" velocity="2"/>'
MASS = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="1"/>'
    '<inertia ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial>'
)
FINGERS = (
    '<link name="lf"/><joint name="fl" type="prismatic"><parent link="tool"/><child link="lf"/><axis xyz="0 1 0"/>'
    '<limit lower="0" upper="0.04" effort="9" velocity="0.1"/></joint><link name="rf"/><joint name="fr" '
    'type="prismatic"><parent link="tool"/><child link="rf"/><axis xyz="0 -1 0"/>'
    '<limit lower="0" upper="0.04" effort="9" velocity="0.1"/><mimic joint="fl"/></joint>'
)
GAZEBO = '<gazebo><controller:p3d name="p"><interface:position name="q"/></controller:p3d></gazebo>'
NAMES = [f"joint{number}" for number in range(1, 7)]
FOLLOWS = '<mimic joint="joint2" multiplier="-1"/>'


def arm(
    third: str = LIMIT,
    axis: str = "0 1 0",
    extra: str = "",
    head: str = '<robot name="arm">',
    inertial: str = MASS,
    joints: int = 6,
) -> str:
    """Revolute joints in a row, of which the third has other limits or another axis; the end is the link tool."""
    parts = [head, '<link name="link0"/>']
    for number in range(1, joints + 1):
        inside = f'<axis xyz="{axis}"/>{third}' if number == 3 else f'<axis xyz="{AXES[number - 1]}"/>{LIMIT}'
        parts.append(
            f'<link name="link{number}">{inertial}</link><joint name="joint{number}" type="revolute">'
            f'<parent link="link{number - 1}"/><child link="link{number}"/><origin xyz="0.05 0 0.2"/>{inside}</joint>'
        )
    parts.append(
        f'<link name="tool"/><joint name="tool_joint" type="fixed"><parent link="link{joints}"/><child link="tool"/>'
        '<origin xyz="0.1 0 0"/></joint>'
    )
    return "\n".join([*parts, extra, "</robot>"])


def limits(lower: str = "-2.9", upper: str = "2.9", velocity: str = "2", effort: str = "9") -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>'


def closing(name: str) -> str:
    return f'<joint name="{name}" type="fixed"><parent link="tool"/><child link="link2"/></joint>'


class DescriptionFault(NamedTuple):
    """A description and what has to be said of it."""

    name: str
    urdf: str
    text: str
    """Part of the error; empty for a description that has to be taken."""
    case: str = ""
    by_solver: bool = True
    """False for what only the node needs: limits and masses."""
    method: str = "plain"


NO_VELOCITY, NO_RANGE = "joint 'joint3' has velocity limit", "joint 'joint3' has position limits"
FAULTS = (
    DescriptionFault("links form a loop", arm(extra=closing("closing")), "link 'link2' has two parents", "W07"),
    DescriptionFault("links form a loop, other order", arm(extra=closing("a")), "link 'link2' has two parents", "W07"),
    DescriptionFault("axis 0 0 0", arm(axis="0 0 0"), "joint 'joint3' has the axis '0 0 0'", "W08"),
    DescriptionFault("axis with nan", arm(axis="0 nan 1"), "joint 'joint3' has xyz", "W08"),
    DescriptionFault("undeclared prefix beside a mimic", arm(extra=FINGERS + GAZEBO), "", "W09"),
    DescriptionFault(
        "mimic in a default namespace",
        arm(third=LIMIT + FOLLOWS, head='<robot name="arm" xmlns="http://www.ros.org">'),
        "",
        "W09",
    ),
    DescriptionFault("negative effort", arm(third=limits(effort="-1")), "", "W10"),
    DescriptionFault("velocity 0", arm(third=limits(velocity="0")), NO_VELOCITY, "W05", False),
    DescriptionFault("velocity -1", arm(third=limits(velocity="-1")), NO_VELOCITY, "W10", False),
    DescriptionFault("limits 0 to 0", arm(third=limits("0", "0")), NO_RANGE, "W06", False),
    DescriptionFault("limits inverted", arm(third=limits("2", "-2")), NO_RANGE, "W06", False),
    DescriptionFault("limits of nan", arm(third=limits(velocity="nan")), "joint 'joint3' has velocity 'nan'"),
    DescriptionFault(
        "no masses, inertia_weighted", arm(inertial="", joints=7), "needs the masses of the links", "W11", False,
        "inertia_weighted",
    ),
    DescriptionFault("not closed", arm()[:-9], "not XML"),
    DescriptionFault("another kind of file", "<html><body>no</body></html>", "its root element is <html>"),
    DescriptionFault("empty", " ", "it is empty"),
    DescriptionFault("entities", '<!DOCTYPE robot [<!ENTITY a "b">]>' + arm(), "it declares the entity 'a'"),
    DescriptionFault("two roots", arm(extra='<link name="stray"/>'), "have no parent joint"),
)  # fmt: skip


def row(fault: DescriptionFault, where: str, status: str, back: str, wrong: str) -> Row:
    """A row without motion."""
    return Row(fault.name, fault.case, where, "-", "-", "-", "-", status, back, wrong)


def test_solver(tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]) -> None:
    rows = []
    for number, fault in enumerate(choose(pytestconfig, "solver", [f for f in FAULTS if f.by_solver], 2)):
        file = tmp_path / f"{number}.urdf"
        file.write_text(fault.urdf)
        target = ["--target", "0.5 0 0.6 0 0 0 1"]
        outcome = one_line(["solve", "--urdf", str(file), "--tip", "tool", *target], fault.text, (0, 1))
        rows.append(row(fault, "ik_solve", *outcome))
    record_property("fault_rows", [list(found) for found in rows])
    assert not failures(rows), "\n".join(failures(rows))


def test_node(tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]) -> None:
    """Each method has a node that is given its broken descriptions, and then a good one."""
    rows = []
    chosen = choose(pytestconfig, "node", [fault for fault in FAULTS if fault.text], 3)
    for method in dict.fromkeys(fault.method for fault in chosen):
        with peer_in_own_domain() as peer:
            options = ["-p", "tip_frame:=tool", "-p", f"method:={method}", "-p", "rate_hz:=50.0"]
            process = peer.start("node", tmp_path, options)
            publisher = peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
            peer.until("the subscription", lambda p=publisher: p.get_subscription_count() > 0)  # type: ignore[misc]
            for fault in (fault for fault in chosen if fault.method == method):
                wrong, begin = "", len(process.log.read_text(errors="replace"))
                publisher.publish(String(data=fault.urdf))
                for _ in range(1000):
                    log = process.log.read_text(errors="replace")[begin:]
                    if fault.text in log or process.exit_code is not None:
                        break
                    peer.spin(0.02)
                else:
                    wrong = f"the log lacks '{fault.text}'"
                if process.exit_code is not None:
                    wrong = f"the node has ended: {process.log_tail()}"
                if "Traceback" in log:
                    wrong = "a traceback"
                lines = [line for line in log.splitlines() if fault.text in line]
                text = lines[0].partition("not configured: ")[2] if lines else ""
                rows.append(row(fault, method, text, "next description", wrong))
            publisher.publish(String(data=arm()))
            peer.until(
                "motion control with the good description",
                lambda p=peer: p.mode == "holding",  # type: ignore[misc]
                lambda p=peer: p.send_state(NAMES, [0.2, 0.3, 0.8, 0.1, -0.6, 0.2]),  # type: ignore[misc]
            )
    record_property("fault_rows", [list(found) for found in rows])
    assert not failures(rows), "\n".join(failures(rows))

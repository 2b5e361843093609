"""Files of bringup/ and docs/jazzy.md: they agree with each other, with config/ and with the robot models."""

from __future__ import annotations

import re
import shlex

import pytest
import yaml
from loop import make_robot
from support import PROJECT

from ik_node.settings.parameter_file import read_settings

BRINGUP = PROJECT / "bringup"
DOC = (PROJECT / "docs" / "jazzy.md").read_text()
DRIVERS = {"ur": ("ur5", ""), "franka": ("panda", "fr3_"), "xarm7": ("xarm7", "")}
"""Driver -> arm with a file in config/, and the prefix that the driver's joints have instead of ``panda_``."""
CONTROLLER = "forward_velocity_controller"


def row(driver: str) -> list[str]:
    """Cells of the driver in the table of docs/jazzy.md."""
    (found,) = [line for line in DOC.splitlines() if line.startswith("|") and f"`{driver}_ik_node.yaml`" in line]
    return [cell.strip() for cell in found.strip("|").split("|")]


def test_there_are_two_files_for_each_driver_and_the_table_names_them() -> None:
    expected = {f"{driver}_{kind}.yaml" for driver in DRIVERS for kind in ("controllers", "ik_node")}
    assert {path.name for path in BRINGUP.iterdir()} == expected
    assert {name for name in expected if f"`{name}`" in DOC} == expected


@pytest.mark.parametrize("driver", DRIVERS)
def test_controller_and_node_have_the_joints_of_the_arm(driver: str) -> None:
    sections = yaml.safe_load((BRINGUP / f"{driver}_controllers.yaml").read_text())["/**"]
    assert list(sections) == [CONTROLLER]
    controller = sections[CONTROLLER]["ros__parameters"]
    settings = read_settings(BRINGUP / f"{driver}_ik_node.yaml")
    robot_name, prefix = DRIVERS[driver]
    robot = make_robot(robot_name)
    expected = tuple(re.sub("^panda_", prefix or "panda_", joint) for joint in robot.joints)
    assert controller["type"] == "velocity_controllers/JointGroupVelocityController"
    assert tuple(controller["joints"]) == settings.arm.joints == expected
    assert len(settings.limits.acceleration) in (1, len(expected))
    if not prefix:
        configured = read_settings(PROJECT / "config" / f"{robot_name}.yaml")
        assert settings.limits.acceleration == configured.limits.acceleration
        assert (settings.arm.base_frame, settings.arm.tip_frame) == (robot.base_frame, robot.tip_frame)


@pytest.mark.parametrize("driver", DRIVERS)
def test_rate_and_topics_are_those_of_the_table(driver: str) -> None:
    _, rate, states, commands, _ = row(driver)
    settings = read_settings(BRINGUP / f"{driver}_ik_node.yaml")
    assert float(rate.split()[0]) == settings.control.rate_hz
    assert commands == f"`{CONTROLLER}/commands`"
    topic = states.split("`")[1]
    if topic != "joint_states":
        assert f"-r joint_states:={topic}" in DOC


def test_every_command_publishes_where_the_controller_listens() -> None:
    topics = re.findall(r"(?:command_topic|ik_node/commands|~/commands):=([\w/]+)", DOC)
    assert len(topics) == 5
    assert set(topics) == {f"/{CONTROLLER}/commands"}
    assert set(re.findall(r"\$BRINGUP/([\w.]+)", DOC)) <= {path.name for path in BRINGUP.iterdir()}


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_lines_of_a_driver_have_its_files_and_topics(driver: str) -> None:
    """Node and watchdog publish on one topic; the node subscribes to the joint states of the table."""
    (block,) = [text for text in re.findall(r"```sh\n(.*?)```", DOC, re.S) if f"{driver}_ik_node.yaml" in text]
    lines = [shlex.split(line) for line in block.replace("\\\n", " ").splitlines()]
    files = {word.rpartition("=")[2] for line in lines for word in line if "$BRINGUP/" in word}
    assert files <= {f"$BRINGUP/{driver}_{kind}.yaml" for kind in ("controllers", "ik_node")}
    assert [name for line in lines for name in (CONTROLLER,) if name in line] == [CONTROLLER], "it is started once"
    remapped = [dict(word.split(":=") for word in line if ":=" in word) for line in lines if "ik_node" in line]
    topics = {
        kept.pop(name)
        for kept in remapped
        for name in ("~/commands", "ik_node/commands", "command_topic")
        if name in kept
    }
    assert topics == {f"/{CONTROLLER}/commands"}
    states = row(driver)[2].split("`")[1]
    assert remapped[-1].get("joint_states", "joint_states") == states


def test_the_files_are_installed() -> None:
    assert 'folder("bringup")' in (PROJECT / "setup.py").read_text()

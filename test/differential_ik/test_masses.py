"""Methods whose weight is the mass matrix are refused for an arm without masses, by name of link; real arms pass."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.controller import Controller
from ik_node.control.warm_up import warm_up
from ik_node.differential_ik.methods import METHODS, check_masses
from ik_node.errors import SettingsError
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

NEED = [name for name, method in METHODS.items() if method.needs_masses]
URDF = catalogue.read_urdf(catalogue.find("panda"))


def panda(change: str = "", replacement: str = "") -> Robot:
    """The panda, without masses unless an inertial element of one link is replaced."""
    if not change:
        urdf = re.sub(r"<inertial>.*?</inertial>", "", URDF, flags=re.DOTALL)
    else:
        pattern = rf'(<link name="{change}">.*?)<inertial>.*?</inertial>'
        urdf = re.sub(pattern, rf"\1{replacement}", URDF, count=1, flags=re.DOTALL)
    return Robot(urdf, "panda_link0", "panda_hand_tcp")


def settings(method: str) -> Settings:
    return Settings().with_values({"method": method})


def test_the_methods_with_the_mass_matrix_are_these() -> None:
    assert sorted(NEED) == ["gravity_gradient", "inertia_weighted", "obstacle_gradient"]


@pytest.mark.parametrize("method", NEED)
def test_an_arm_without_masses_is_refused_at_the_start_and_at_a_change(method: str) -> None:
    robot = panda()
    words = rf"method '{method}' needs the masses.*'panda_joint1'.*panda_link1, panda_link2,.*more.*use method 'plain'"
    with pytest.raises(SettingsError, match=words):
        Controller(robot, settings(method))
    loop = Loop(robot, READY["panda"], settings("plain"))
    loop.run(0.05)
    before = loop.controller.settings
    for change in (loop.controller.check, loop.controller.apply):
        with pytest.raises(SettingsError, match=words):
            change(settings(method))
    assert loop.controller.settings is before
    loop.run(0.05)
    assert np.isfinite([step.joint_velocity for step in loop.steps]).all()


def test_an_arm_without_masses_is_warmed_up() -> None:
    warm_up(panda(), settings("plain"))


@pytest.mark.parametrize(
    "inertial",
    [
        "",
        '<inertial><mass value="0"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>',
        '<inertial><mass value="-9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>',
    ],
)
def test_one_link_without_mass_is_named_where_it_matters(inertial: str) -> None:
    """An ur5 whose last link has none: its last joint moves nothing. A link in the middle of an arm may have none."""
    entry = catalogue.find("ur5")
    urdf = catalogue.read_urdf(entry)
    assert re.search(r'<link name="wrist_3_link">', urdf)
    urdf = re.sub(
        r'(<link name="wrist_3_link">.*?)<inertial>.*?</inertial>', rf"\1{inertial}", urdf, count=1, flags=re.DOTALL
    )
    with pytest.raises(SettingsError, match=r"are missing or invalid \(wrist_3_link, ee_link, tool0\)"):
        check_masses("inertia_weighted", Robot(urdf, entry.base_frame, entry.tip_frame))
    check_masses("inertia_weighted", panda("panda_link3", ""))


@pytest.mark.parametrize("name", catalogue.ARMS)
def test_the_shipped_arms_have_the_masses(name: str) -> None:
    """Their frames without mass are fixed to links with mass; a tool adds one more."""
    for method in METHODS:
        check_masses(method, make_robot(name))
    entry = catalogue.find(name)
    arm = dataclasses.replace(Settings().arm, robot=name, tip_frame=entry.tip_frame)
    tool = dataclasses.replace(arm, tool_offset=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0))
    check_masses("inertia_weighted", catalogue.robot_from_settings(tool))

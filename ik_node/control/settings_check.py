"""Checks of settings against the robot, before they are applied."""

from __future__ import annotations

from collections.abc import Collection

from ik_node.differential_ik.selected_method import check_method
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.locked_chain import free_joints
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings


def check_settings(robot: Robot, settings: Settings, own_methods: Collection[str]) -> None:
    """Raises SettingsError when settings do not match the robot; ``own_methods``: names of those that are loaded."""
    check_method(robot, settings, own_methods)
    free_joints(robot.joints, settings.control.locked_joints)
    motion_limits(robot, settings.limits, settings.control.rate_hz)

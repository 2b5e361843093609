"""Checks of settings against the robot, before they are applied."""

from __future__ import annotations

from ik_node.differential_ik.methods import check_masses
from ik_node.differential_ik.posture import check_posture
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings


def check_settings(robot: Robot, settings: Settings) -> None:
    """Raises SettingsError when settings do not match the robot."""
    check_masses(settings.control.method, robot)
    motion_limits(robot, settings.limits, settings.control.rate_hz)
    check_posture(robot, settings.obstacles)

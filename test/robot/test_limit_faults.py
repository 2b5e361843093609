"""Limits of a URDF that cannot be meant: refused with joint and parameter, unless a parameter replaces them."""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.errors import SettingsError
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings

GOOD = '<limit lower="-2.9" upper="2.9" effort="50" velocity="2"/>'


def arm(limit: str, kind: str = "revolute") -> Robot:
    """Three joints in a row; the second has this limit."""
    parts = ['<link name="link0"/>']
    for number, (joint, tag) in enumerate((("revolute", GOOD), (kind, limit), ("revolute", GOOD)), 1):
        parts.append(
            f'<link name="link{number}"/><joint name="joint{number}" type="{joint}"><parent link="link{number - 1}"/>'
            f'<child link="link{number}"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>{tag}</joint>'
        )
    return Robot(f'<robot name="arm">{"".join(parts)}</robot>', joint_prefix="left_")


def limit(lower: str = "-2.9", upper: str = "2.9", velocity: str = "2", effort: str = "50") -> str:
    return f'<limit lower="{lower}" upper="{upper}" effort="{effort}" velocity="{velocity}"/>'


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
@pytest.mark.parametrize("velocity", ["0", "-1", "-0.0"])
def test_a_velocity_limit_that_is_not_positive(kind: str, velocity: str) -> None:
    robot = arm(limit(velocity=velocity), kind)
    with pytest.raises(SettingsError, match=r"'left_joint2' has velocity limit .* in the URDF; set limits.velocity$"):
        motion_limits(robot, LimitSettings(), 500.0)
    assert motion_limits(robot, LimitSettings(velocity=(0.5,)), 500.0).velocity.tolist() == [0.5] * 3


def test_a_velocity_limit_that_is_missing() -> None:
    with pytest.raises(SettingsError, match=r"'left_joint2' has velocity limit 0"):
        motion_limits(arm('<limit lower="-1" upper="1" effort="1" velocity="0"/>'), LimitSettings(), 500.0)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(("lower", "upper"), [("0", "0"), ("2.9", "-2.9"), ("1", "1")])
def test_position_limits_without_range(kind: str, lower: str, upper: str) -> None:
    robot = arm(limit(lower, upper), kind)
    expected = r"'left_joint2' has position limits .* in the URDF; set limits.position_lower and limits.position_upper$"
    for settings in (LimitSettings(), LimitSettings(position_lower=(-1.0,)), LimitSettings(velocity=(1.0,))):
        with pytest.raises(SettingsError, match=expected):
            motion_limits(robot, settings, 500.0)
    limits = motion_limits(robot, LimitSettings(position_lower=(-1.0,), position_upper=(1.0,)), 500.0)
    assert limits.lower.tolist() == [-1.0] * 3


def test_all_faults_are_named_at_once() -> None:
    expected = r"velocity limit -1 .*, .*position limits 0 to 0 .*; set limits.velocity and limits.position_lower and"
    with pytest.raises(SettingsError, match=expected):
        motion_limits(arm(limit("0", "0", "-1")), LimitSettings(), 500.0)


def test_a_continuous_joint_has_no_limits_where_the_urdf_says_so() -> None:
    for tag in ("", limit("0", "0")):
        limits = motion_limits(arm(tag, "continuous"), LimitSettings(), 500.0)
        assert np.isinf([limits.lower[1], limits.upper[1]]).all()
    assert np.isinf(motion_limits(arm("", "continuous"), LimitSettings(), 500.0).velocity[1])


def test_a_negative_effort_does_not_matter() -> None:
    robot = arm(limit(effort="-1"))
    assert robot.limit_faults == ()
    assert motion_limits(robot, LimitSettings(), 500.0).velocity.tolist() == [2.0] * 3
    assert arm(limit(effort="-1", velocity="-1")).limit_faults[0].joint == "left_joint2"

"""Potentials of the joint positions: centre of the joint range, and a preferred posture."""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential
from ik_node.errors import SettingsError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings


def joint_centering(robot: Robot, q: Array, stiffness: float) -> Potential:
    """h = stiffness / 2 sum ((q - middle) / (half range))^2 (Liegeois 1977).

    Args:
        robot: The robot; joints without two position limits do not contribute.
        q: Joint positions, (n,), rad (m).
        stiffness: J.
    """
    lower, upper = robot.limits.lower, robot.limits.upper
    limited = np.isfinite(lower) & np.isfinite(upper)
    lower, upper = np.where(limited, lower, -1.0), np.where(limited, upper, 1.0)
    half = 0.5 * (upper - lower)
    offset = np.where(limited, (q - 0.5 * (lower + upper)) / half, 0.0)
    return Potential(0.5 * stiffness * float(offset @ offset), stiffness * offset / half)


def posture_potential(robot: Robot, q: Array, posture: Array, stiffness: float) -> Potential:
    """h = stiffness / 2 ||q - posture||^2, with the difference of continuous joints taken modulo one turn.

    Args:
        robot: The robot.
        q: Joint positions, (n,), rad (m).
        posture: Preferred joint positions, (n,), rad (m).
        stiffness: N m/rad (N/m).
    """
    offset = -robot.difference(q, posture)
    return Potential(0.5 * stiffness * float(offset @ offset), stiffness * offset)


def check_posture(robot: Robot, settings: ObstacleSettings) -> None:
    """Raises SettingsError when ``obstacles.posture`` has neither one value nor one per joint."""
    count = len(settings.posture)
    if count not in (0, 1, robot.n):
        order = ", ".join(robot.joints)
        raise SettingsError(f"obstacles.posture has {count} values; expected 1 or {robot.n}, in the order {order}")


def secondary_gradient(robot: Robot, q: Array, settings: ObstacleSettings) -> Array | None:
    """Sum of the gradients of joint centering and posture at q (n,), (n,), N m (N); None if neither is configured."""
    total = None
    if settings.centring > 0.0:
        total = joint_centering(robot, q, settings.centring).gradient
    if settings.posture_weight > 0.0 and settings.posture:
        posture = np.broadcast_to(settings.posture, robot.n)
        pull = posture_potential(robot, q, posture, settings.posture_weight).gradient
        total = pull if total is None else total + pull
    return total

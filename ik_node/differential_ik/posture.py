"""Where the joints would like to be: in the middle of their range, or at a posture."""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings


def centring(robot: Robot, q: Array, stiffness: float) -> Potential:
    """h = stiffness / 2 sum ((q - middle) / (half range))^2 over the joints that have limits; ``stiffness`` in J.

    Continuous joints have no middle and do not count (Liegeois 1977).
    """
    lower, upper = robot.limits.lower, robot.limits.upper
    limited = np.isfinite(lower) & np.isfinite(upper)
    lower, upper = np.where(limited, lower, -1.0), np.where(limited, upper, 1.0)
    half = 0.5 * (upper - lower)
    offset = np.where(limited, (q - 0.5 * (lower + upper)) / half, 0.0)
    return Potential(0.5 * stiffness * float(offset @ offset), stiffness * offset / half)


def towards(robot: Robot, q: Array, wanted: Array, stiffness: float) -> Potential:
    """h = stiffness / 2 ||q - wanted||^2, the short way round for continuous joints; ``stiffness`` in N m/rad."""
    offset = -robot.difference(q, wanted)
    return Potential(0.5 * stiffness * float(offset @ offset), stiffness * offset)


def secondary_gradient(robot: Robot, q: Array, settings: ObstacleSettings) -> Array | None:
    """Sum of the gradients of joint centring and posture at q (n,), (n,), N m (N); None when neither is configured."""
    total = None
    if settings.centring > 0.0:
        total = centring(robot, q, settings.centring).gradient
    if settings.posture_weight > 0.0 and len(settings.posture) == robot.n:
        pull = towards(robot, q, np.array(settings.posture), settings.posture_weight).gradient
        total = pull if total is None else total + pull
    return total

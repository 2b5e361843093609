"""Where the joints would like to be: in the middle of their range, or at a posture."""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential
from ik_node.math.types import Array
from ik_node.robot.robot import Robot


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

"""The potential energy of the arm's masses: downhill is where it would hang."""

from __future__ import annotations

import numpy as np

from ik_node.collision.avoidance import Potential
from ik_node.robot.robot import Dynamics


def gravity(dynamics: Dynamics, stiffness: float = 1.0) -> Potential:
    """``stiffness`` times the gradient of the gravitational energy, N m; its value is not computed (NaN)."""
    return Potential(float("nan"), np.asarray(stiffness * dynamics.gravity))

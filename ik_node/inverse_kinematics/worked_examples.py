"""The worked examples of the lecture notes: Example 6.1 (planar 2R arm) and the scalar equation of Fig. 6.7."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.inverse_kinematics.newton_raphson import RootSolution, find_root
from ik_node.math.types import Array
from ik_node.robot.screw_chain import ScrewChain


class PoseExample(NamedTuple):
    """An arm, its goal pose, and the start of the iteration."""

    chain: ScrewChain
    pose_sd: Array
    start: Array


def planar_2r() -> PoseExample:
    """Example 6.1: links of 1 m, goal at (30, 90) degrees, start at (0, 30) degrees.

    T_sd is printed in the notes with three decimals, so that its rotation has determinant 0.99996; here it is exact:
    Rz(120 deg), p = ((sqrt 3 - 1) / 2, (sqrt 3 + 1) / 2, 0).
    """
    home = np.eye(4)
    home[0, 3] = 2.0
    chain = ScrewChain.from_angular_first(home, body=[[0, 0], [0, 0], [1, 1], [0, 0], [2, 1], [0, 0]])
    root = np.sqrt(3.0)
    goal = np.eye(4)
    goal[:2, :2] = [[-0.5, -0.5 * root], [0.5 * root, -0.5]]
    goal[:2, 3] = (root - 1.0) / 2.0, (root + 1.0) / 2.0
    return PoseExample(chain, goal, np.deg2rad([0.0, 30.0]))


PLATEAU_X_D = 0.5
PLATEAU_ROOTS = (1.0, 3.0)
PLATEAU_STARTS = (3.4, 0.6, 2.1, 2.0)
"""Converges to the right root, to the other root, diverges (near the plateau), is singular (on it)."""


def plateau_f(theta: Array) -> Array:
    """f of a scalar equation like that of Fig. 6.7: x_d - f(theta) has roots 1 and 3 and a plateau at 2."""
    return np.asarray(1.0 - 1.0 / (1.0 + (theta - 2.0) ** 4))


def plateau_slope(theta: Array) -> Array:
    """df / dtheta, (1, 1)."""
    return np.asarray(4.0 * (theta - 2.0) ** 3 / (1.0 + (theta - 2.0) ** 4) ** 2).reshape(1, 1)


def plateau(start: float, *, tolerance: float = 1e-10, max_iterations: int = 50) -> RootSolution:
    """Newton-Raphson on x_d - f(theta) = 0 from ``start``; ``value`` of the iterates is x_d - f(theta)."""
    return find_root(
        lambda theta: PLATEAU_X_D - plateau_f(theta),
        start,
        lambda theta: -plateau_slope(theta),
        tolerance=tolerance,
        max_iterations=max_iterations,
    )

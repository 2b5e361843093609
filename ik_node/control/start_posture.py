"""Choice of the start posture of a simulated arm for which none is configured.

Zeros are singular for most arms, and a limit or a collision for some. The posture is chosen by measures instead, among
:data:`CANDIDATES` evenly spread postures:

- each joint is at least :data:`LIMIT_MARGIN` of its range away from its limits;
- links and obstacles are at least :data:`CLEARANCE_M` apart, or :data:`CLEARANCE_FRACTION` of the largest distance
  where links are closer in every posture;
- of the :data:`SHORT_LIST` of these with the largest smallest singular value of the Jacobian, the one where this value
  remains largest when the tool moves by :data:`MOVE_M` to and fro along each axis of the base.

The choice is the same every time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.collision.monitor import CollisionMonitor
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

CANDIDATES = 500
LIMIT_MARGIN = 0.2
"""Fraction of the range of a joint."""
LARGEST_ANGLE_RAD = np.pi
"""Joints with a larger range, or without limits, start within this angle of 0."""
LARGEST_STROKE_M = 0.5
"""The same for prismatic joints."""
CLEARANCE_M = 0.05
CLEARANCE_FRACTION = 0.75
SHORT_LIST = 40
MOVE_M = 0.1


class StartPosture(NamedTuple):
    """A posture and its measures."""

    position: Array
    """Joint positions (n,), rad (m)."""
    singular_value: float
    """Smallest singular value of the Jacobian with weighted angular rows, m."""
    clearance_m: float
    """Smallest distance between links, or to an obstacle; inf if none is computed."""

    def describe(self, joints: tuple[str, ...]) -> str:
        """One line for the log."""
        listed = ", ".join(f"{name} {value:.3f}" for name, value in zip(joints, self.position.tolist(), strict=True))
        return f"start posture chosen, none is configured: {listed} ({self.measures})"

    @property
    def measures(self) -> str:
        """Why the posture was chosen."""
        clearance = "" if np.isinf(self.clearance_m) else f", {1e3 * self.clearance_m:.0f} mm clearance"
        return (
            f"smallest singular value {self.singular_value:.3f} m{clearance}, "
            f"at least {100.0 * LIMIT_MARGIN:.0f} % of each range from the limits"
        )


def choose_start_posture(robot: Robot, settings: Settings | None = None) -> StartPosture:
    """The start posture of an arm.

    Args:
        robot: The arm.
        settings: Characteristic length, collision geometry and obstacles; default values without.

    Raises:
        SceneError: The scene file cannot be used.
    """
    settings = settings or Settings()
    monitor = CollisionMonitor(robot, settings.obstacles)
    scale = np.repeat((1.0, settings.control.characteristic_length), 3)[:, None]
    postures = [StartPosture(q, _singular_value(robot, q, scale), _clearance(monitor, q)) for q in _candidates(robot)]
    largest = max(posture.clearance_m for posture in postures)
    free = min(CLEARANCE_M, CLEARANCE_FRACTION * largest) if largest > 0.0 else largest
    listed = [posture for posture in postures if posture.clearance_m >= free]
    listed.sort(key=lambda posture: -posture.singular_value)
    return max(listed[:SHORT_LIST], key=lambda posture: _value_nearby(robot, monitor, posture.position, scale))


def _value_nearby(robot: Robot, monitor: CollisionMonitor, q: Array, scale: Array) -> float:
    """Smallest singular value where the tool has moved, to first order; 0 beyond a limit or in a collision."""
    kinematics = robot.evaluate(q)
    inverse = np.linalg.pinv(kinematics.jacobian_b)
    least = np.inf
    for move_s in MOVE_M * np.vstack((np.eye(3), -np.eye(3))):
        near = q + inverse @ np.concatenate((kinematics.pose_sb[:3, :3].T @ move_s, np.zeros(3)))
        if (near < robot.limits.lower).any() or (near > robot.limits.upper).any() or _clearance(monitor, near) <= 0.0:
            return 0.0
        least = min(least, _singular_value(robot, near, scale))
    return float(least)


def _singular_value(robot: Robot, q: Array, scale: Array) -> float:
    """Smallest singular value of the Jacobian with weighted angular rows, m."""
    return float(np.linalg.svd(scale * robot.evaluate(q).jacobian_b, compute_uv=False)[-1])


def _candidates(robot: Robot) -> Array:
    """Postures (k, n) away from the limits."""
    largest = np.where(robot.revolute, LARGEST_ANGLE_RAD, LARGEST_STROKE_M)
    lower, upper = robot.limits.lower, robot.limits.upper
    margin = np.where(np.isfinite(upper - lower), LIMIT_MARGIN * (upper - lower), 0.0)
    lower, upper = lower + margin, upper - margin
    inside = (lower <= largest) & (upper >= -largest)  # else the range does not contain a posture near 0
    lower, upper = (
        np.where(inside, np.maximum(lower, -largest), lower),
        np.where(inside, np.minimum(upper, largest), upper),
    )
    return lower + (upper - lower) * low_discrepancy_points(np.arange(CANDIDATES), robot.n)


def _clearance(monitor: CollisionMonitor, q: Array) -> float:
    rest = np.zeros(len(q))
    terms = monitor.update(q, rest, rest, 0.0, 0, False)
    return float("inf") if terms is None else terms.closest.distance

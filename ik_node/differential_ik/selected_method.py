"""The cost of the configured method: its weight and gradient, with the secondary gradients of the settings."""

from __future__ import annotations

import numpy as np

from ik_node.differential_ik.methods import METHODS, MethodCost, check_masses
from ik_node.differential_ik.posture import check_posture, secondary_gradient
from ik_node.errors import SettingsError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings


class SelectedMethod:
    """The method that the settings name."""

    def __init__(self, robot: Robot) -> None:
        """:meth:`configure` has to follow."""
        self._robot = robot

    def configure(self, settings: Settings) -> None:
        """Selects the method of the settings.

        Raises:
            SettingsError: As :func:`check_method`; nothing has changed then.
        """
        check_method(self._robot, settings)
        self.name = settings.control.method
        self._obstacles = settings.obstacles
        self._method = METHODS[self.name]
        weights = settings.control.joint_weights
        self._joint_weights = np.array(weights) if weights else np.ones(self._robot.n)

    @property
    def avoids_obstacles(self) -> bool:
        """True if the gradient is that of the repulsive potential of obstacles."""
        return self._method.avoids_obstacles

    def cost(self, q_middle: Array, q: Array, repulsion: Array | None) -> MethodCost:
        """Weight of the method, and its gradient plus the secondary gradients.

        Args:
            q_middle: Joint positions in the middle of the control interval, (n,), rad (m), for the method.
            q: Measured joint positions, (n,), rad (m), for the secondary gradients.
            repulsion: Gradient of the repulsive potential of obstacles, (n,), N m (N); None if it is not known.
        """
        weight, gradient = self._method.cost(self._robot, q_middle, repulsion, self._joint_weights)
        secondary = secondary_gradient(self._robot, q, self._obstacles)
        if secondary is not None:
            gradient = secondary if gradient is None else gradient + secondary
        return MethodCost(weight, gradient)


def check_method(robot: Robot, settings: Settings) -> None:
    """Raises SettingsError when the method, its weights or the posture do not match the robot."""
    check_masses(settings.control.method, robot)
    count = len(settings.control.joint_weights)
    if count not in (0, robot.n):
        order = ", ".join(robot.joints)
        raise SettingsError(f"joint_weights has {count} values; expected {robot.n}, in the order {order}")
    check_posture(robot, settings.obstacles)

"""The cost of the configured method: its weight and gradient, with the secondary gradients of the settings.

An own method of the user (:mod:`ik_node.differential_ik.own_methods`) that fails is replaced by ``plain`` in the same
control step and until it is selected again or the controller is reset. The command changes within the acceleration
limits, as at every change of the method, and the task is followed as before.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ik_node.differential_ik.methods import METHODS, MethodCost, check_masses
from ik_node.differential_ik.own_methods import GivenMethods, load_methods
from ik_node.differential_ik.posture import check_posture, secondary_gradient
from ik_node.errors import MethodFault, SettingsError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

NO_COST = MethodCost(None, None)
"""That of ``plain``."""


class SelectedMethod:
    """The method that the settings name."""

    def __init__(self, robot: Robot, settings: Settings, own: GivenMethods | None = None) -> None:
        """Loads own methods; :meth:`configure` has to follow.

        Raises:
            SettingsError: An own method cannot be loaded.
        """
        self._robot = robot
        self.own = load_methods(robot, settings.control, own)
        """The own methods that were loaded: name -> method."""
        self._own_robot = robot.copy()
        self._name = ""
        self.fault = ""
        """Why the own method is replaced by ``plain``; empty if it is not."""

    def configure(self, settings: Settings) -> None:
        """Selects the method of the settings; another one than before has no fault.

        Raises:
            SettingsError: As :func:`check_method`; nothing has changed then.
        """
        check_method(self._robot, settings, self.own)
        name, weights = settings.control.method, settings.control.joint_weights
        if name != self._name:
            self._name, self.fault = name, ""
        self._obstacles = settings.obstacles
        self._built_in, self._own = METHODS.get(name), self.own.get(name)
        self._joint_weights = np.array(weights) if weights else np.ones(self._robot.n)

    @property
    def avoids_obstacles(self) -> bool:
        """True if the gradient is that of the repulsive potential of obstacles."""
        return self._built_in is not None and self._built_in.avoids_obstacles

    @property
    def note(self) -> str:
        """Status text about a fault; empty without one."""
        return f"{self.fault}; continued with plain" if self.fault else ""

    def without_effect(self, unavailable: str, joints: int, exact: int) -> str:
        """Reason why the gradient has no effect; empty if it has.

        Args:
            unavailable: Why no distances are computed; empty if they are.
            joints: Number of joints that move.
            exact: Number of components that are followed exactly.
        """
        if self.avoids_obstacles:
            if unavailable:
                return f"{self._name} has no effect, no distances are computed: {unavailable}"
            if joints <= exact:
                return f"{self._name} has no effect: {joints} joints and {exact} exact components, no null space"
        if self._obstacles.posture_weight > 0.0 and not self._obstacles.posture:
            return "obstacles.posture_weight has no effect: obstacles.posture is empty"
        return ""

    def fail(self, reason: str) -> None:
        """Replaces the own method by ``plain``; without effect for a built-in one."""
        if self._own is not None and not self.fault:
            self.fault = reason

    def clear_fault(self) -> None:
        """Uses the own method again."""
        self.fault = ""

    def cost(self, q_middle: Array, q: Array, repulsion: Array | None) -> MethodCost:
        """Weight of the method, and its gradient plus the secondary gradients.

        Args:
            q_middle: Joint positions in the middle of the control interval, (n,), rad (m), for the method.
            q: Measured joint positions, (n,), rad (m), for the secondary gradients.
            repulsion: Gradient of the repulsive potential of obstacles, (n,), N m (N); None if it is not known.
        """
        if self._built_in is not None:
            weight, gradient = self._built_in.cost(self._robot, q_middle, repulsion, self._joint_weights)
        else:
            weight, gradient = self._own_cost(q_middle)
        secondary = secondary_gradient(self._robot, q, self._obstacles)
        if secondary is not None:
            gradient = secondary if gradient is None else gradient + secondary
        return MethodCost(weight, gradient)

    def _own_cost(self, q: Array) -> MethodCost:
        if self._own is None or self.fault:
            return NO_COST
        try:
            return MethodCost(*self._own.cost(self._own_robot, q)[:2])
        except MethodFault as fault:
            self.fault = str(fault)
            return NO_COST


def check_method(robot: Robot, settings: Settings, own: Collection[str] = ()) -> None:
    """Checks that method, weights and posture match the robot.

    Args:
        robot: The robot.
        settings: The settings.
        own: Names of the own methods that are loaded.

    Raises:
        SettingsError: They do not match; names the parameter.
    """
    control = settings.control
    if control.method in METHODS:
        check_masses(control.method, robot)
    elif control.method not in own:
        valid = ", ".join((*METHODS, *own))
        raise SettingsError(f"method '{control.method}' was not loaded at the start by extra_methods; valid: {valid}")
    count = len(control.joint_weights)
    if count not in (0, robot.n):
        order = ", ".join(robot.joints)
        raise SettingsError(f"joint_weights has {count} values; expected {robot.n}, in the order {order}")
    check_posture(robot, settings.obstacles)

"""The methods: costs that select the joint velocity among those that give the same twist.

Each method is a weight W and a gradient for the cost 1/2 qd' W qd + k grad_h' qd of
:mod:`ik_node.differential_ik.closed_form`. :data:`METHODS` is the table of all of them; the parameter ``method``
accepts its names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class MethodCost(NamedTuple):
    """The cost of a method at one q."""

    weight: Array | None
    """W, (n, n), symmetric positive definite; None is the identity."""
    gradient: Array | None
    """grad_h, (n,), N m (N); None is zero."""


class Method(NamedTuple):
    """One method; calling it computes its cost."""

    cost: Callable[[Robot, Array, Array | None], MethodCost]
    avoids_obstacles: bool = False
    """True if the gradient is that of the repulsive potential; the null space is then used to evade obstacles."""

    def __call__(self, robot: Robot, q: Array, repulsion: Array | None) -> MethodCost:
        """The cost at q.

        Args:
            robot: The robot.
            q: Joint positions, (n,), rad (m).
            repulsion: Gradient of the repulsive potential of obstacles, (n,), N m (N); None if it is not known.
        """
        return self.cost(robot, q, repulsion)


def _plain(robot: Robot, q: Array, repulsion: Array | None) -> MethodCost:
    """Least joint velocity: W = I (lecture notes, section 3, "Pseudoinverse")."""
    del robot, q, repulsion
    return MethodCost(None, None)


def _inertia_weighted(robot: Robot, q: Array, repulsion: Array | None) -> MethodCost:
    """Least kinetic energy: W = M(q) (lecture notes, section 3, "Inertia-weighted Pseudoinverse")."""
    del repulsion
    return MethodCost(robot.dynamics(q).mass_matrix, None)


def _gravity_gradient(robot: Robot, q: Array, repulsion: Array | None) -> MethodCost:
    """Least kinetic energy plus k times the rate of the gravitational energy ("Weighted Pseudoinverse")."""
    del repulsion
    dynamics = robot.dynamics(q)
    return MethodCost(dynamics.mass_matrix, dynamics.gravity)


def _obstacle_gradient(robot: Robot, q: Array, repulsion: Array | None) -> MethodCost:
    """Least kinetic energy plus k times the rate of the repulsive potential."""
    return MethodCost(robot.dynamics(q).mass_matrix, repulsion)


METHODS: Mapping[str, Method] = {
    "plain": Method(_plain),
    "inertia_weighted": Method(_inertia_weighted),
    "obstacle_gradient": Method(_obstacle_gradient, avoids_obstacles=True),
    "gravity_gradient": Method(_gravity_gradient),
}
"""Name -> method. The settings repeat the names as the choices of ``method``; a test compares both."""

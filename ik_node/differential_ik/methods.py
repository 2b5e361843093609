"""The methods: which joint velocities are the cheapest among those that give the same twist.

Each is a weight W and a gradient for the cost 1/2 qd' W qd + k grad_h' qd of :mod:`ik_node.differential_ik.closed_form`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class Cost(NamedTuple):
    """What a method makes of one q."""

    weight: Array | None
    """W, (n, n), symmetric positive definite; None is the identity."""
    gradient: Array | None
    """grad_h, (n,), J/rad (J/m); None is zero."""


Method = Callable[[Robot, Array, Array | None], Cost]
"""Of the robot, q (n,) and the gradient of the potential that grows near obstacles (n,), where that is known."""


def plain(robot: Robot, q: Array, repulsion: Array | None) -> Cost:
    """Least joint velocity: W = I (lecture notes, section 3, "Pseudoinverse")."""
    del robot, q, repulsion
    return Cost(None, None)


def inertia_weighted(robot: Robot, q: Array, repulsion: Array | None) -> Cost:
    """Least kinetic energy: W = M(q) (lecture notes, section 3, "Inertia-weighted Pseudoinverse")."""
    del repulsion
    return Cost(robot.dynamics(q).mass_matrix, None)


def gravity_gradient(robot: Robot, q: Array, repulsion: Array | None) -> Cost:
    """Least kinetic energy plus k times the rate of the gravitational energy ("Weighted Pseudoinverse")."""
    del repulsion
    dynamics = robot.dynamics(q)
    return Cost(dynamics.mass_matrix, dynamics.gravity)


def obstacle_gradient(robot: Robot, q: Array, repulsion: Array | None) -> Cost:
    """Least kinetic energy plus k times the rate of a potential that grows near obstacles."""
    return Cost(robot.dynamics(q).mass_matrix, repulsion)


METHODS: Mapping[str, Method] = {
    method.__name__: method for method in (plain, inertia_weighted, obstacle_gradient, gravity_gradient)
}
"""Name -> method; the names that the parameter ``method`` takes."""

"""The methods: which joint velocities are the cheapest among those that give the same twist.

Each is a weight W and a gradient for the cost 1/2 qd' W qd + k grad_h' qd of :mod:`ik_node.resolution`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol

from ik_node.robot import Robot
from ik_node.se3 import Array


class Cost(NamedTuple):
    """What a method makes of one q."""

    weight: Array | None
    """W, (n, n), symmetric positive definite; None is the identity."""
    gradient: Array | None
    """grad_h, (n,), J/rad (J/m); None is zero."""


class Potential(Protocol):
    """A scalar h(q) that grows towards what is to be avoided."""

    def gradient(self, q: Array) -> Array:
        """grad_h, (n,), at q (n,) [rad, m]: J/rad (J/m)."""


Method = Callable[[Robot, Array, Potential | None], Cost]


def plain(robot: Robot, q: Array, potential: Potential | None) -> Cost:
    """Least joint velocity: W = I (lecture notes, section 3, "Pseudoinverse")."""
    del robot, q, potential
    return Cost(None, None)


def inertia_weighted(robot: Robot, q: Array, potential: Potential | None) -> Cost:
    """Least kinetic energy: W = M(q) (lecture notes, section 3, "Inertia-weighted Pseudoinverse")."""
    del potential
    return Cost(robot.dynamics(q).mass_matrix, None)


def gravity_gradient(robot: Robot, q: Array, potential: Potential | None) -> Cost:
    """Least kinetic energy plus k times the rate of the gravitational energy ("Weighted Pseudoinverse")."""
    del potential
    dynamics = robot.dynamics(q)
    return Cost(dynamics.mass_matrix, dynamics.gravity)


def obstacle_gradient(robot: Robot, q: Array, potential: Potential | None) -> Cost:
    """Least kinetic energy plus k times the rate of a potential that grows near obstacles."""
    return Cost(robot.dynamics(q).mass_matrix, None if potential is None else potential.gradient(q))


METHODS: Mapping[str, Method] = {
    method.__name__: method for method in (plain, inertia_weighted, obstacle_gradient, gravity_gradient)
}
"""Name -> method; the names that the parameter ``method`` takes."""

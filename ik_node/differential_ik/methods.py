"""The methods: costs that select the joint velocity among those that give the same twist.

Each method is a weight W and a gradient for the cost 1/2 qd' W qd + k grad_h' qd of
:mod:`ik_node.differential_ik.closed_form`. :data:`METHODS` is the table of all of them; the parameter ``method``
accepts its names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from ik_node.errors import SettingsError
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

MIN_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a usable mass matrix, scaled to ones on its diagonal; real arms have 0.02 and more."""
MIN_DIAGONAL = 1e-12
"""Smallest element on the diagonal of a usable mass matrix, relative to the largest; real arms have 1e-4 and more."""
MASS_POSITIONS = 4
"""Number of positions at which the mass matrix is checked: links without mass show at almost every position."""


class MethodCost(NamedTuple):
    """The cost of a method at one q."""

    weight: Array | None
    """W, (n, n), symmetric positive definite; None is the identity."""
    gradient: Array | None
    """grad_h, (n,), N m (N); None is zero."""


class Method(NamedTuple):
    """One method; calling it computes its cost."""

    cost: Callable[[Robot, Array, Array | None, Array | None], MethodCost]
    needs_masses: bool = False
    """True if W is the mass matrix, which has to be positive definite."""
    avoids_obstacles: bool = False
    """True if the gradient is that of the repulsive potential; the null space is then used to evade obstacles."""

    def __call__(
        self, robot: Robot, q: Array, repulsion: Array | None = None, joint_weights: Array | None = None
    ) -> MethodCost:
        """The cost at q.

        Args:
            robot: The robot.
            q: Joint positions, (n,), rad (m).
            repulsion: Gradient of the repulsive potential of obstacles, (n,), N m (N); None if it is not known.
            joint_weights: Weights of the joints, (n,), > 0; None for equal ones.
        """
        return self.cost(robot, q, repulsion, joint_weights)


def _plain(robot: Robot, q: Array, repulsion: Array | None, joint_weights: Array | None) -> MethodCost:
    """Least joint velocity: W = I (lecture notes, section 3, "Pseudoinverse")."""
    del robot, q, repulsion, joint_weights
    return MethodCost(None, None)


def _inertia_weighted(robot: Robot, q: Array, repulsion: Array | None, joint_weights: Array | None) -> MethodCost:
    """Least kinetic energy: W = M(q) (lecture notes, section 3, "Inertia-weighted Pseudoinverse")."""
    del repulsion, joint_weights
    return MethodCost(robot.dynamics(q).mass_matrix, None)


def _gravity_gradient(robot: Robot, q: Array, repulsion: Array | None, joint_weights: Array | None) -> MethodCost:
    """Least kinetic energy plus k times the rate of the gravitational energy ("Weighted Pseudoinverse")."""
    del repulsion, joint_weights
    dynamics = robot.dynamics(q)
    return MethodCost(dynamics.mass_matrix, dynamics.gravity)


def _obstacle_gradient(robot: Robot, q: Array, repulsion: Array | None, joint_weights: Array | None) -> MethodCost:
    """Least kinetic energy plus k times the rate of the repulsive potential."""
    del joint_weights
    return MethodCost(robot.dynamics(q).mass_matrix, repulsion)


def _joint_weighted(robot: Robot, q: Array, repulsion: Array | None, joint_weights: Array | None) -> MethodCost:
    """Least weighted joint velocity: W = diag(w); a joint with a larger weight moves less."""
    del robot, q, repulsion
    return MethodCost(None if joint_weights is None else np.diag(joint_weights), None)


METHODS: Mapping[str, Method] = {
    "plain": Method(_plain),
    "inertia_weighted": Method(_inertia_weighted, needs_masses=True),
    "obstacle_gradient": Method(_obstacle_gradient, needs_masses=True, avoids_obstacles=True),
    "gravity_gradient": Method(_gravity_gradient, needs_masses=True),
    "joint_weighted": Method(_joint_weighted),
}
"""Name -> method. The settings repeat the names as the choices of ``method``; a test compares both."""


def check_masses(name: str, robot: Robot) -> None:
    """Checks that a method has the masses that it needs.

    Args:
        name: Name of the method.
        robot: The robot.

    Raises:
        SettingsError: The method uses the mass matrix, and that is not positive definite; names links without mass.
    """
    if not METHODS[name].needs_masses:
        return
    lower, upper = np.maximum(robot.limits.lower, -np.pi), np.minimum(robot.limits.upper, np.pi)
    for fraction in low_discrepancy_points(np.arange(MASS_POSITIONS), robot.n):
        joint = joint_without_weight(robot.dynamics(lower + fraction * (upper - lower)).mass_matrix)
        if joint is not None:
            links = robot.moved_links(joint)
            massless = [link for link in links if robot.description.masses.get(link, 0.0) <= 0.0] or list(links)
            named = ", ".join(massless[:4]) + (f" and {len(massless) - 4} more" if len(massless) > 4 else "")
            raise SettingsError(
                f"method '{name}' needs the masses of the links, and those that joint '{robot.joints[joint]}' moves "
                f"are missing or invalid ({named}); for a massless arm use method 'plain'"
            )


def joint_without_weight(mass: Array) -> int | None:
    """Index of a joint that makes a mass matrix or another weight (n, n) unusable; None if it is positive definite."""
    diagonal = np.diagonal(mass)
    if not np.isfinite(mass).all():
        return int(np.flatnonzero(~np.isfinite(mass).all(axis=0))[0])
    if diagonal.min() <= MIN_DIAGONAL * diagonal.max():
        return int(diagonal.argmin())
    scale = np.sqrt(diagonal)
    eigenvalues, directions = np.linalg.eigh(mass / np.outer(scale, scale))
    return None if eigenvalues[0] > MIN_EIGENVALUE else int(np.abs(directions[:, 0]).argmax())

"""Own methods of a user, as functions of a module that is imported by its name: good ones, and one of each fault."""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.math.types import Array
from ik_node.robot.robot import Robot

NUMBER = 3


def gravity(robot: Robot, q: Array) -> Any:
    """The built-in method gravity_gradient, with its potential."""
    mass, gradient = robot.dynamics(q)
    return mass, gradient, robot.gravitational_energy(q)


def centre(robot: Robot, q: Array) -> Any:
    """Towards zero, with unit weight; modifies its argument."""
    gradient = 2.0 * q
    potential = float(q @ q)
    q *= 0.0
    return None, gradient, potential


def without_gradient(robot: Robot, q: Array) -> Any:
    return np.diag(1.0 + np.arange(robot.n)), None


def one_argument(q: Array) -> Any:
    return None, q


def raises(robot: Robot, q: Array) -> Any:
    raise ZeroDivisionError("nothing to\ndivide by")


def ends_the_process(robot: Robot, q: Array) -> Any:
    raise SystemExit(3)


def nothing(robot: Robot, q: Array) -> Any:
    return None


def one_value(robot: Robot, q: Array) -> Any:
    return (q,)


def wrong_weight(robot: Robot, q: Array) -> Any:
    return np.eye(robot.n - 1), None


def wrong_gradient(robot: Robot, q: Array) -> Any:
    return None, np.zeros(robot.n + 1)


def text_gradient(robot: Robot, q: Array) -> Any:
    return None, "steep"


def not_symmetric(robot: Robot, q: Array) -> Any:
    weight = np.eye(robot.n)
    weight[0, 1] = 0.1
    return weight, None


def indefinite(robot: Robot, q: Array) -> Any:
    return np.ones((robot.n, robot.n)) + 0.5 * np.eye(robot.n) - 1.2 * np.outer(q, q) / (q @ q + 1e-9), None


def negative(robot: Robot, q: Array) -> Any:
    return -np.eye(robot.n), None


def singular(robot: Robot, q: Array) -> Any:
    return np.ones((robot.n, robot.n)), None


def vast(robot: Robot, q: Array) -> Any:
    return 1e12 * np.eye(robot.n), None


def steep(robot: Robot, q: Array) -> Any:
    return None, np.full(robot.n, 1e300)


def not_finite(robot: Robot, q: Array) -> Any:
    return None, q * np.nan


def infinite_weight(robot: Robot, q: Array) -> Any:
    return np.full((robot.n, robot.n), np.inf), None


def other_gradient(robot: Robot, q: Array) -> Any:
    gradient = 2.0 * q
    gradient[2] *= -1.0
    return None, gradient, q @ q


def potential_alone(robot: Robot, q: Array) -> Any:
    return None, None, q @ q


def vector_potential(robot: Robot, q: Array) -> Any:
    return None, q, q

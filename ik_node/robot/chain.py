"""Prediction of a serial chain from its present Jacobian alone: Jacobian, pose and joint velocities ahead.

Column i of the body Jacobian is the screw of joint i in {b}, which the joints behind it move (Lynch and Park, Modern
Robotics, 5.1). So the columns at q determine Jacobian and pose at q + change exactly, without the robot's model::

    T(q + change) = T(q) exp([b_1] change_1) ... exp([b_n] change_n)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.types import Array


@compiled
def moved_chain(jacobian: Array, order: NDArray[np.int64], change: Array) -> tuple[Array, Array]:
    """Body Jacobian (6, n) after a change of the joint positions, and T(q + change)^-1 T(q), (4, 4).

    Args:
        jacobian: J_b, (6, n).
        order: Indices of the joints from the base to the tool, (n,).
        change: Change of the joint positions, (n,), rad (m).
    """
    moved, tail, screw = np.empty_like(jacobian), np.eye(4), np.empty(6)
    for k in range(len(order) - 1, -1, -1):
        i = order[k]
        for row in range(6):
            screw[row] = jacobian[row, i]
        moved[:, i] = se3.transform_twist(tail, screw)
        # tail = exp(-[b_n] change_n) ... exp(-[b_i] change_i)
        tail = se3.compose(tail, se3.exp6(-change[i] * screw))
    return moved, tail


PATH_DAMPING = 1e-3
"""Damping of the joint velocities along a known path, in its prediction and in the control law, m."""

SLOW = 0.3
"""A joint with a lower velocity limit than this fraction of the highest one is slow."""


@compiled
def relative_speeds(velocity: Array) -> Array:
    """Velocity limits of slow joints, (n,), relative to those of the others, which have 1.

    In the norm of velocities relative to them an arm with a null space moves a slow joint little, as its limits make
    it do. Arms without a null space have 1 everywhere.

    Args:
        velocity: Velocity limits, (n,), rad/s (m/s).
    """
    speeds, most = np.ones(len(velocity)), 0.0
    if len(velocity) > 6:
        for value in velocity:
            if np.isfinite(value):
                most = max(most, value)
        for i in range(len(velocity)):
            if np.isfinite(velocity[i]):
                speeds[i] = min(1.0, velocity[i] / (SLOW * most))
    return speeds


@compiled
def damped_rates(jacobian: Array, twist: Array, row_scale: Array, damping: float, speeds: Array) -> Array:
    """Joint velocities (n,) of least norm \\|qd / speeds\\| for a twist, by damped least squares (Wampler 1986).

    Args:
        jacobian: J, (6, n).
        twist: V, (6,).
        row_scale: D, (6,).
        damping: Singular values of D J S far above it are inverted, those far below it are ignored, m.
        speeds: Diagonal of S, (n,), see :func:`relative_speeds`.
    """
    n, squares = jacobian.shape[1], speeds * speeds
    a, y = np.empty((6, 6)), np.empty(6)
    # Cholesky decomposition of D J J' D + damping^2, row by row, with the forward substitution.
    for i in range(6):
        for j in range(i + 1):
            value = 0.0
            for k in range(n):
                value += jacobian[i, k] * jacobian[j, k] * squares[k]
            value *= row_scale[i] * row_scale[j]
            if i == j:
                value += damping * damping
            for k in range(j):
                value -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(value) if i == j else value / a[j, j]
        value = row_scale[i] * twist[i]
        for k in range(i):
            value -= a[i, k] * y[k]
        y[i] = value / a[i, i]
    rates = np.zeros(n)
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            y[i] -= a[k, i] * y[k]
        y[i] /= a[i, i]
        for k in range(n):
            rates[k] += squares[k] * jacobian[i, k] * row_scale[i] * y[i]
    return rates

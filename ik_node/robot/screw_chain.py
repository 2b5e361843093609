"""Arms given by screw axes, as the notes give them: home pose M and body screws B_i, or space screws S_i.

Product of exponentials (Modern Robotics 4.1, 5.1)::

    T_sb(theta) = M e^([B_1] theta_1) ... e^([B_n] theta_n) = e^([S_1] theta_1) ... e^([S_n] theta_n) M
    J_b column i = Ad(e^(-[B_n] theta_n) ... e^(-[B_i+1] theta_i+1)) B_i ,    J_s = Ad(T_sb) J_b
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.pseudoinverse import finite_matrix
from ik_node.math.se3 import vector
from ik_node.math.types import Array
from ik_node.robot.robot import JointLimits, Kinematics


class KinematicChain(Protocol):
    """What inverse kinematics wants of an arm: :class:`ik_node.robot.robot.Robot` and :class:`ScrewChain` have it."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def limits(self) -> JointLimits:
        """Infinite where a joint has none."""

    @property
    def turning(self) -> NDArray[np.bool_]:
        """True where a joint is revolute, so that a full turn changes nothing, (n,)."""

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4)."""

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian at q (n,)."""


class ScrewChain:
    """An arm given by its home pose and one screw axis per joint."""

    def __init__(
        self, home: ArrayLike, screws_b: ArrayLike, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> None:
        """``home`` M (4, 4) and body screws ``screws_b`` (6, n), columns B_i with the linear part first.

        ``lower`` and ``upper`` (n,) are position limits, none by default. Screw lists with the angular part first, as
        the notes and Modern Robotics print them, go through :meth:`from_angular_first`. Raises InputError naming the
        argument: no rigid motion, not (6, n), not finite, or limits that leave no room.
        """
        self.home = se3.checked_pose(home, "home")
        self.screws_b = finite_matrix(screws_b, "screws_b").copy()
        if len(self.screws_b) != 6:
            raise InputError(f"screws_b has shape {self.screws_b.shape}, expected (6, n)")
        self.n = self.screws_b.shape[1]
        self.limits = JointLimits(
            _bound(lower, -np.inf, self.n, "lower"), _bound(upper, np.inf, self.n, "upper"), np.full(self.n, np.inf)
        )
        if (self.limits.lower > self.limits.upper).any():
            raise InputError(f"lower {self.limits.lower.tolist()} exceeds upper {self.limits.upper.tolist()}")
        self.turning = np.array([_is_revolute(screw) for screw in self.screws_b.T])

    @classmethod
    def from_angular_first(
        cls,
        home: ArrayLike,
        body: ArrayLike | None = None,
        space: ArrayLike | None = None,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
    ) -> ScrewChain:
        """From ``home`` M and either ``body`` screws B_i or ``space`` screws S_i, columns (omega, v) of (6, n)."""
        if (body is None) == (space is None):
            raise InputError("screws: give either body or space screws")
        if space is not None:
            columns = se3.angular_first(finite_matrix(space, "space"))
            return cls(home, se3.adjoint(se3.inverse(se3.checked_pose(home, "home"))) @ columns, lower, upper)
        return cls(home, se3.angular_first(finite_matrix(body if body is not None else [], "body")), lower, upper)

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4), of joint positions q (n,) in rad (m)."""
        return self.evaluate(q).pose_sb

    def joint_origins(self, q: Array) -> Array:
        """For drawing: of each revolute axis the point nearest the base's origin at q (n,), in m, one row per axis."""
        pose, jacobian = self.evaluate(q)
        axes = (se3.adjoint(pose) @ jacobian)[:, self.turning]
        return np.cross(axes[3:].T, axes[:3].T)

    def evaluate(self, q: Array) -> Kinematics:
        """T_sb and body Jacobian (6, n), linear rows first, at q (n,)."""
        tail = np.eye(4)
        jacobian = np.empty((6, self.n))
        for index in reversed(range(self.n)):
            screw = self.screws_b[:, index]
            jacobian[:, index] = se3.adjoint(se3.inverse(tail)) @ screw
            tail = se3.exp(screw * q[index]) @ tail
        return Kinematics(self.home @ tail, jacobian)


def wrap_angle(theta: Array) -> Array:
    """``theta`` plus the turns of 2 pi that bring it into -pi..pi."""
    return np.asarray(theta - 2.0 * np.pi * np.round(theta / (2.0 * np.pi)))


def fold(theta: Array, chain: KinematicChain) -> tuple[Array, bool]:
    """``theta`` with the fewest turns of 2 pi per revolute joint that bring it within the limits, and whether it is.

    Joints without limits go to -pi..pi; joints that are inside, or that no turn brings inside, stay as they are.
    """
    lower, upper = chain.limits.lower, chain.limits.upper
    turn = 2.0 * np.pi
    up, down = np.ceil((lower - theta) / turn), np.floor((upper - theta) / turn)
    turns = np.where(theta < lower, up, np.where(theta > upper, down, 0.0))
    free = np.isinf(lower) & np.isinf(upper)
    turns = np.where(free, -np.round(theta / turn), turns)
    moved = theta + turn * turns
    possible = chain.turning & (moved >= lower) & (moved <= upper)
    folded = np.where(possible, moved, theta)
    return folded, bool(((folded >= lower) & (folded <= upper)).all())


def _bound(values: ArrayLike | None, default: float, n: int, name: str) -> Array:
    if values is None:
        return np.full(n, default)
    array = np.array(values, dtype=np.float64)
    return np.where(np.isinf(array), array, vector(np.where(np.isinf(array), 0.0, array), n, name))


def _is_revolute(screw: Array) -> bool:
    """A full turn about ``screw`` (unit omega, no pitch) leads back to the start."""
    v, omega = screw[:3], screw[3:]
    length = float(np.sqrt(omega @ omega))
    return abs(length - 1.0) < 1e-9 and abs(float(omega @ v)) < 1e-9 * (1.0 + float(np.abs(v).max()))

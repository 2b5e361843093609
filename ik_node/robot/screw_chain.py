"""Arms defined by screw axes: home pose M and body screws B_i or space screws S_i.

Product of exponentials (Lynch and Park, Modern Robotics, 4.1 and 5.1)::

    T_sb(theta) = M e^([B_1] theta_1) ... e^([B_n] theta_n) = e^([S_1] theta_1) ... e^([S_n] theta_n) M
    J_b column i = Ad(e^(-[B_n] theta_n) ... e^(-[B_i+1] theta_i+1)) B_i ,    J_s = Ad(T_sb) J_b
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_node.errors import InputError
from ik_node.math import se3
from ik_node.math.numerics import checked_matrix, checked_vector
from ik_node.math.types import Array
from ik_node.robot.kinematics import JointLimits, Kinematics


class KinematicChain(Protocol):
    """Interface of inverse kinematics; implemented by :class:`~ik_node.robot.robot.Robot` and :class:`ScrewChain`."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def limits(self) -> JointLimits:
        """Limits of the joints; infinite where a joint has none."""

    @property
    def turning(self) -> NDArray[np.bool_]:
        """(n,), bool: True for revolute joints, for which a full turn changes nothing."""

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4)."""

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian at q (n,)."""


class ScrewChain:
    """An arm defined by its home pose and one screw axis per joint."""

    def __init__(
        self, home: ArrayLike, screws_b: ArrayLike, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> None:
        """Defines the arm; see :meth:`from_angular_first` for screws with the angular part first.

        Args:
            home: M, pose of the tool at q = 0, (4, 4).
            screws_b: Body screws B_i as columns, linear part first, (6, n).
            lower: Lower position limits, (n,), rad (m); default: none.
            upper: Upper position limits, (n,), rad (m); default: none.

        Raises:
            InputError: An argument has the wrong shape, is not finite or not a pose, or lower exceeds upper; names it.
        """
        self.home = se3.checked_pose(home, "home")
        self.screws_b = checked_matrix(screws_b, "screws_b").copy()
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
        """Defines the arm by screws (omega, v), as printed in Modern Robotics and the lecture notes.

        Args:
            home: M, pose of the tool at q = 0, (4, 4).
            body: Body screws B_i as columns, (6, n); either these or ``space``.
            space: Space screws S_i as columns, (6, n).
            lower: Lower position limits, (n,), rad (m); default: none.
            upper: Upper position limits, (n,), rad (m); default: none.

        Returns:
            The arm.

        Raises:
            InputError: Not exactly one of ``body`` and ``space``, or an argument is invalid.
        """
        if (body is None) == (space is None):
            raise InputError("screws: expected either body or space screws")
        if space is not None:
            columns = se3.angular_first(checked_matrix(space, "space"))
            return cls(home, se3.adjoint(se3.inverse(se3.checked_pose(home, "home"))) @ columns, lower, upper)
        return cls(home, se3.angular_first(checked_matrix(body if body is not None else [], "body")), lower, upper)

    def pose(self, q: Array) -> Array:
        """T_sb(q), (4, 4), at joint positions q (n,), rad (m)."""
        return self.evaluate(q).pose_sb

    def joint_origins(self, q: Array) -> Array:
        """Point of each revolute axis nearest to the base's origin at q (n,), (axes, 3), m; for drawings."""
        pose, jacobian = self.evaluate(q)
        axes = (se3.adjoint(pose) @ jacobian)[:, self.turning]
        return np.cross(axes[3:].T, axes[:3].T)

    def evaluate(self, q: Array) -> Kinematics:
        """T_sb, (4, 4), and body Jacobian, (6, n), linear rows first, at q (n,)."""
        tail = np.eye(4)
        jacobian = np.empty((6, self.n))
        for index in reversed(range(self.n)):
            screw = self.screws_b[:, index]
            jacobian[:, index] = se3.adjoint(se3.inverse(tail)) @ screw
            tail = se3.exp(screw * q[index]) @ tail
        return Kinematics(self.home @ tail, jacobian)


def wrap_angle(theta: Array) -> Array:
    """``theta`` shifted by multiples of 2 pi into -pi..pi."""
    return np.asarray(theta - 2.0 * np.pi * np.round(theta / (2.0 * np.pi)))


def wrap_into_limits(theta: Array, chain: KinematicChain) -> tuple[Array, bool]:
    """Shifts revolute joints into their limits by the smallest number of full turns.

    Joints without limits are shifted into -pi..pi. Joints inside their limits, or for which no number of turns leads
    inside, keep their value.

    Args:
        theta: Joint positions, (n,), rad (m).
        chain: The arm.

    Returns:
        The shifted positions, (n,), and whether all joints are within their limits.
    """
    lower, upper = chain.limits.lower, chain.limits.upper
    turn = 2.0 * np.pi
    up, down = np.ceil((lower - theta) / turn), np.floor((upper - theta) / turn)
    turns = np.where(theta < lower, up, np.where(theta > upper, down, 0.0))
    unlimited = np.isinf(lower) & np.isinf(upper)
    turns = np.where(unlimited, -np.round(theta / turn), turns)
    shifted = theta + turn * turns
    possible = chain.turning & (shifted >= lower) & (shifted <= upper)
    wrapped = np.where(possible, shifted, theta)
    return wrapped, bool(((wrapped >= lower) & (wrapped <= upper)).all())


def finite_range(chain: KinematicChain) -> tuple[Array, Array]:
    """Lower and upper ends, (n,) each, of the joint range; where limits are missing, of one turn or of two metres."""
    lower, upper = chain.limits.lower, chain.limits.upper
    reach = np.where(chain.turning, np.pi, 1.0)
    low = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper - 2.0 * reach, -reach))
    return low, np.where(np.isfinite(upper), upper, low + 2.0 * reach)


def _bound(values: ArrayLike | None, default: float, n: int, name: str) -> Array:
    if values is None:
        return np.full(n, default)
    array = np.array(values, dtype=np.float64)
    return np.where(np.isinf(array), array, checked_vector(np.where(np.isinf(array), 0.0, array), n, name))


def _is_revolute(screw: Array) -> bool:
    """True when a full turn about ``screw`` is the identity: unit omega, zero pitch."""
    v, omega = screw[:3], screw[3:]
    length = float(np.sqrt(omega @ omega))
    return abs(length - 1.0) < 1e-9 and abs(float(omega @ v)) < 1e-9 * (1.0 + float(np.abs(v).max()))

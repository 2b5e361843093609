"""Joints that are held: which ones, and an arm whose coordinates are the other joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import SettingsError
from ik_node.math.types import Array
from ik_node.robot.kinematics import JointLimits, Kinematics
from ik_node.robot.screw_chain import KinematicChain


def free_joints(joints: Sequence[str], locked: Sequence[str]) -> NDArray[np.intp]:
    """Indices of the joints that are not locked.

    Args:
        joints: Names of all joints.
        locked: Names of the locked ones.

    Raises:
        SettingsError: A name is unknown, or every joint is locked.
    """
    for name in locked:
        if name not in joints:
            raise SettingsError(f"locked_joints has '{name}', which is no joint of the arm; valid: {', '.join(joints)}")
    free = [index for index, name in enumerate(joints) if name not in locked]
    if not free:
        raise SettingsError(f"locked_joints has all {len(joints)} joints; valid: at most {len(joints) - 1} of them")
    return np.array(free, dtype=np.intp)


class LockedChain:
    """An arm with locked joints as a chain of the others; implements :class:`KinematicChain`."""

    def __init__(self, chain: KinematicChain, free: NDArray[np.intp], q: Array) -> None:
        """Holds joints.

        Args:
            chain: The arm.
            free: Indices of the joints that move.
            q: Joint positions (n,), rad (m), at which the others stay.
        """
        self._chain, self._free, self._q = chain, free, q
        self.n = len(free)
        limits = chain.limits
        self.limits = JointLimits(limits.lower[free], limits.upper[free], limits.velocity[free])
        self.turning = chain.turning[free]

    def all_joints(self, q: Array) -> Array:
        """Positions of all joints, (n,), for those of the chain."""
        whole = np.array(self._q)
        whole[self._free] = q
        return whole

    def pose(self, q: Array) -> Array:
        """T_sb, (4, 4)."""
        return self._chain.pose(self.all_joints(q))

    def evaluate(self, q: Array) -> Kinematics:
        """Pose and body Jacobian."""
        pose, jacobian = self._chain.evaluate(self.all_joints(q))[:2]
        return Kinematics(pose, np.ascontiguousarray(jacobian[:, self._free]))

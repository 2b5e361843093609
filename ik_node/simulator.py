"""A robot that integrates velocity commands: the ideal arm that a demonstration and the tests drive."""

from __future__ import annotations

import numpy as np

from ik_node.clock import NS
from ik_node.errors import InputError
from ik_node.robot import JointLimits
from ik_node.se3 import Array


class SimulatedArm:
    """Joint positions under a velocity that stands until the next one, as ros2_control's velocity interface has it.

    It has no watchdog, as real velocity controllers have none: the last command keeps standing. It stops at position
    limits and follows no velocity beyond the joint's own.
    """

    def __init__(self, position: Array, limits: JointLimits, time_ns: int) -> None:
        """Starts at rest at ``position`` (n,), rad (m)."""
        self._position = position.copy()
        self._limits = limits
        self._velocity = np.zeros(len(position))
        self._time_ns = time_ns
        self.commands = 0
        """Commands taken."""

    def advance(self, time_ns: int) -> tuple[Array, Array]:
        """Joint positions and velocities, (n,) each, at a monotonic time that never goes back."""
        elapsed_s = max(time_ns - self._time_ns, 0) / NS
        self._time_ns = max(time_ns, self._time_ns)
        self._position += elapsed_s * self._velocity
        np.clip(self._position, self._limits.lower, self._limits.upper, out=self._position)
        return self._position.copy(), self._velocity.copy()

    def command(self, velocity: Array, time_ns: int) -> None:
        """Takes a velocity command (n,), in force from ``time_ns`` on; InputError (nothing changes) when it is unfit.

        As forward_command_controller does: a command of the wrong size or with a value that is not finite is dropped.
        """
        if velocity.shape != self._velocity.shape:
            raise InputError(f"command has {velocity.size} values, expected {self._velocity.size}")
        if not np.isfinite(velocity).all():
            raise InputError(f"command is not finite: {velocity}")
        self.advance(time_ns)
        self._velocity = np.clip(velocity, -self._limits.velocity, self._limits.velocity)
        self.commands += 1

"""A robot that integrates velocity commands: ideal, or late, slow and noisy as real ones are."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.robot import JointLimits
from ik_node.settings.groups import Group, setting


@dataclass(frozen=True)
class ArmModel(Group):
    """How a simulated arm answers; the defaults are an ideal one."""

    lag_s: float = setting(0.0, "Time constant of the first-order answer of each joint's velocity.", "s", 0.0, 1.0)
    delay_s: float = setting(0.0, "Time from a command's arrival until the arm knows it.", "s", 0.0, 1.0)
    encoder_noise: float = setting(0.0, "Standard deviation of the measured positions.", "rad or m", 0.0, 0.1)
    dropout: float = setting(0.0, "Part of the joint states that get lost.", "", 0.0, 1.0)
    seed: int = setting(0, "Of noise and dropouts.")


class SimulatedArm:
    """Joint positions under a velocity that stands until the next one, as ros2_control's velocity interface has it.

    It has no watchdog, as real velocity controllers have none: the last command keeps standing. It stops at position
    limits and follows no velocity beyond the joint's own.
    """

    def __init__(self, position: Array, limits: JointLimits, time_ns: int, model: ArmModel | None = None) -> None:
        """Starts at rest at ``position`` (n,), rad (m)."""
        self.model = model or ArmModel()
        rest = np.zeros(len(position))
        self._joints = np.array([position, rest, rest, limits.lower, limits.upper], dtype=np.float64)
        """Per joint (5, n): position, velocity, the command that it knows, and its limits."""
        self._fastest = limits.velocity
        self._slowest = -limits.velocity
        self._waiting: deque[tuple[int, Array]] = deque()
        self._time_ns = time_ns
        self._delay_ns = round(self.model.delay_s * NS)
        self._generator = np.random.default_rng(self.model.seed)
        self._move(time_ns)  # compiles

    def advance(self, time_ns: int) -> tuple[Array, Array]:
        """True joint positions and velocities, (n,) each, at a monotonic time that never goes back."""
        self._go_on(time_ns)
        return self._joints[0].copy(), self._joints[1].copy()

    def measure(self, time_ns: int) -> Array | None:
        """Measured joint positions (n,), with the model's noise; None where the measurement got lost."""
        position, _ = self.advance(time_ns)
        if self.model.dropout > 0.0 and self._generator.random() < self.model.dropout:
            return None
        if self.model.encoder_noise > 0.0:
            position += self.model.encoder_noise * self._generator.standard_normal(len(position))
        return position

    def command(self, velocity: Array, time_ns: int) -> None:
        """Takes a velocity command (n,) that arrives now; InputError (nothing changes) when it is unfit.

        As forward_command_controller does: a command of the wrong size or with a value that is not finite is dropped.
        """
        if velocity.shape != self._fastest.shape:
            raise InputError(f"command has {velocity.size} values, expected {self._fastest.size}")
        if not all(map(math.isfinite, velocity.tolist())):
            raise InputError(f"command is not finite: {velocity}")
        limited = np.minimum(np.maximum(velocity, self._slowest), self._fastest)
        self._waiting.append((time_ns + self._delay_ns, limited))
        self._go_on(time_ns)

    def _go_on(self, time_ns: int) -> None:
        while self._waiting and self._waiting[0][0] <= time_ns:
            from_ns, command = self._waiting.popleft()
            self._move(from_ns)
            self._joints[2] = command
        self._move(time_ns)

    def _move(self, time_ns: int) -> None:
        elapsed_s = max(time_ns - self._time_ns, 0) / NS
        self._time_ns = max(time_ns, self._time_ns)
        _move(self._joints, elapsed_s, float(self.model.lag_s))


@compiled
def _move(joints: Array, elapsed_s: float, lag_s: float) -> None:
    """Moves :attr:`SimulatedArm._joints` on."""
    left = math.exp(-elapsed_s / lag_s) if lag_s > 0.0 else 0.0
    for joint in range(joints.shape[1]):
        position, command = joints[0, joint], joints[2, joint]
        behind = joints[1, joint] - command if lag_s > 0.0 else 0.0
        position += elapsed_s * command + lag_s * (1.0 - left) * behind
        if position < joints[3, joint]:
            position = joints[3, joint]
        elif position > joints[4, joint]:
            position = joints[4, joint]
        joints[0, joint] = position
        joints[1, joint] = command + left * behind

"""Simulated arm with a velocity interface: ideal, or with delay, lag, noise and lost measurements."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.robot.kinematics import JointLimits
from ik_node.settings.schema import Group, setting


@dataclass(frozen=True)
class ArmModel(Group):
    """Dynamics of a simulated arm; the defaults are an ideal arm."""

    lag_s: float = setting(0.0, "Time constant of the first-order lag of each joint's velocity.", "s", 0.0, 1.0)
    delay_s: float = setting(0.0, "Delay from the arrival of a command until the arm applies it.", "s", 0.0, 1.0)
    encoder_noise: float = setting(0.0, "Standard deviation of the measured positions.", "rad or m", 0.0, 0.1)
    dropout: float = setting(0.0, "Ratio of joint states that are lost.", "", 0.0, 1.0)
    seed: int = setting(0, "Seed of noise and dropouts.")


class SimulatedArm:
    """Integrates joint velocity commands, each held until the next one, like ros2_control's velocity interface.

    Like real velocity controllers it has no watchdog: the last command stays active. It stops at position limits and
    clips commands to the velocity limits.
    """

    def __init__(self, position: Array, limits: JointLimits, time_ns: int, model: ArmModel | None = None) -> None:
        """Starts at rest.

        Args:
            position: Initial joint positions, (n,), rad (m).
            limits: Limits of the joints.
            time_ns: Monotonic time.
            model: Dynamics; default: ideal.
        """
        self.model = model or ArmModel()
        rest = np.zeros(len(position))
        self._joints = np.array([position, rest, rest, limits.lower, limits.upper], dtype=np.float64)
        """(5, n): position, velocity, applied command, lower and upper limit of each joint."""
        self._max_velocity = limits.velocity
        self._min_velocity = -limits.velocity
        self._queue: deque[tuple[int, Array]] = deque()
        self._time_ns = time_ns
        self._delay_ns = round(self.model.delay_s * NS)
        self._generator = np.random.default_rng(self.model.seed)
        self._integrate(time_ns)  # compiles the function

    def advance(self, time_ns: int) -> tuple[Array, Array]:
        """True joint positions and velocities, (n,) each, at a monotonic time that never decreases."""
        self._advance(time_ns)
        return self._joints[0].copy(), self._joints[1].copy()

    def measure(self, time_ns: int) -> Array | None:
        """Measured joint positions (n,), rad (m), with noise; None when the measurement is lost."""
        position, _ = self.advance(time_ns)
        if self.model.dropout > 0.0 and self._generator.random() < self.model.dropout:
            return None
        if self.model.encoder_noise > 0.0:
            position += self.model.encoder_noise * self._generator.standard_normal(len(position))
        return position

    def command(self, velocity: Array, time_ns: int) -> None:
        """Adds a velocity command, as forward_command_controller does.

        Args:
            velocity: Joint velocities, (n,), rad/s (m/s).
            time_ns: Monotonic time of arrival.

        Raises:
            InputError: The command has the wrong size or is not finite; it is ignored.
        """
        if velocity.shape != self._max_velocity.shape:
            raise InputError(f"command has {velocity.size} values, expected {self._max_velocity.size}")
        if not all(map(math.isfinite, velocity.tolist())):
            raise InputError(f"command is not finite: {velocity}")
        limited = np.minimum(np.maximum(velocity, self._min_velocity), self._max_velocity)
        self._queue.append((time_ns + self._delay_ns, limited))
        self._advance(time_ns)

    def _advance(self, time_ns: int) -> None:
        while self._queue and self._queue[0][0] <= time_ns:
            applied_ns, command = self._queue.popleft()
            self._integrate(applied_ns)
            self._joints[2] = command
        self._integrate(time_ns)

    def _integrate(self, time_ns: int) -> None:
        elapsed_s = max(time_ns - self._time_ns, 0) / NS
        self._time_ns = max(time_ns, self._time_ns)
        _integrate(self._joints, elapsed_s, float(self.model.lag_s))


@compiled
def _integrate(joints: Array, elapsed_s: float, lag_s: float) -> None:
    """Integrates :attr:`SimulatedArm._joints` over ``elapsed_s``."""
    decay = math.exp(-elapsed_s / lag_s) if lag_s > 0.0 else 0.0
    for joint in range(joints.shape[1]):
        position, command = joints[0, joint], joints[2, joint]
        difference = joints[1, joint] - command if lag_s > 0.0 else 0.0
        position += elapsed_s * command + lag_s * (1.0 - decay) * difference
        if position < joints[3, joint]:
            position = joints[3, joint]
        elif position > joints[4, joint]:
            position = joints[4, joint]
        joints[0, joint] = position
        joints[1, joint] = command + decay * difference

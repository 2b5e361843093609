"""Smith predictor: compensates the delay and the lag of the arm's velocity response.

A command takes effect after delay + lag, and so does its effect on the measured position. Without compensation the tool
lags behind a moving target by the acceleration during that time. The model: each joint velocity follows its command
after ``delay_s`` with a first-order lag ``lag_s``. The commands given so far then move the joints further by

    offset(t) = integral of (command - velocity of the model) dt

The feedback law is evaluated at the predicted position, with the target extrapolated by the same time (Smith, "Closer
control of loops with dead time", Chemical Engineering Progress 53, 1957). The offset is zero without delay and lag, and
at rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import ControlSettings

SMOOTHING = 1.0
"""Time constant of the averaged target acceleration, in multiples of delay + lag."""


class SmithPredictorSnapshot(NamedTuple):
    """Attributes of a :class:`SmithPredictor`."""

    time_ns: int
    """Monotonic time of the model."""
    offset: Array
    """Predicted offset, (n,), rad (m)."""
    velocity: Array
    """Velocity of the model, (n,), rad/s (m/s)."""
    applied: Array
    """Command applied by the model, (n,), rad/s (m/s)."""
    commanded: Array
    """Newest command, (n,), rad/s (m/s)."""
    queue: tuple[tuple[int, Array], ...]
    """Commands that the model has not applied yet, each with the monotonic time of application."""
    twist_d: Array | None
    """Target twist of the last control step, (6,); None at the first."""
    acceleration_d: Array
    """Averaged target acceleration, (6,)."""


class SmithPredictor:
    """Delay and lag model of the arm, driven by the commands."""

    def __init__(self, n: int, settings: ControlSettings) -> None:
        """``n``: number of joints."""
        self._n = n
        self.reset(0)
        self.configure(settings)

    def configure(self, settings: ControlSettings) -> None:
        """Applies a changed lag and delay."""
        self._lag_s, self._delay_ns = settings.arm_lag_s, round(settings.arm_delay_s * NS)
        self.total_delay_s = settings.arm_lag_s + settings.arm_delay_s
        """Delay + lag, s."""

    def reset(self, time_ns: int) -> None:
        """Resets the model to rest at a monotonic time."""
        self._time_ns = time_ns
        self._offset, self._velocity = np.zeros(self._n), np.zeros(self._n)
        self._applied, self._commanded = np.zeros(self._n), np.zeros(self._n)
        self._queue: tuple[tuple[int, Array], ...] = ()
        self._twist_d: Array | None = None
        self._acceleration_d = np.zeros(6)

    def target(self, motion: Motion, interval_s: float) -> Motion:
        """Extrapolates the target ``motion`` by delay + lag; ``interval_s``: time since the last control step."""
        previous = motion.twist_d if self._twist_d is None else self._twist_d
        self._twist_d = motion.twist_d
        predicted, self._acceleration_d = _extrapolated(
            motion, previous, self._acceleration_d, interval_s, self.total_delay_s
        )
        return predicted

    def command(self, velocity: Array, time_ns: int) -> None:
        """Adds a command (n,), rad/s (m/s), given at a monotonic time."""
        if self.total_delay_s > 0.0:
            self.predicted_offset(time_ns)
            self._commanded = velocity
            self._queue = (*self._queue, (time_ns + self._delay_ns, velocity))

    def predicted_offset(self, time_ns: int) -> Array:
        """Further motion of the joints due to the commands given so far, (n,), rad (m)."""
        while self._queue and self._queue[0][0] <= time_ns:
            applied_ns, command = self._queue[0]
            self._advance(applied_ns)
            self._applied, self._queue = command, self._queue[1:]
        self._advance(time_ns)
        return self._offset

    def _advance(self, time_ns: int) -> None:
        elapsed_s = max(time_ns - self._time_ns, 0) / NS
        self._time_ns = max(time_ns, self._time_ns)
        self._offset, self._velocity = _advanced(
            self._offset, self._velocity, self._applied, self._commanded, elapsed_s, self._lag_s
        )


@compiled
def _extrapolated(
    motion: Motion, previous_twist: Array, acceleration: Array, interval_s: float, total_delay_s: float
) -> tuple[Motion, Array]:
    """Target ``total_delay_s`` after ``motion``, and its averaged acceleration."""
    # Target oscillations faster than the delay are averaged out, because the arm cannot follow them.
    weight = 1.0 - math.exp(-interval_s / (SMOOTHING * total_delay_s))
    newest = (motion.twist_d - previous_twist) / interval_s
    acceleration = acceleration + weight * (newest - acceleration)
    change = total_delay_s * acceleration
    pose_sd = se3.compose(motion.pose_sd, se3.exp6(total_delay_s * (motion.twist_d + 0.5 * change)))
    return Motion(pose_sd, motion.twist_d + change), acceleration


@compiled
def _advanced(
    offset: Array, velocity: Array, applied: Array, commanded: Array, elapsed_s: float, lag_s: float
) -> tuple[Array, Array]:
    """Predicted offset and velocity of the model ``elapsed_s`` later."""
    if lag_s <= 0.0:
        return offset + elapsed_s * commanded - elapsed_s * applied, applied
    decay, difference = math.exp(-elapsed_s / lag_s), velocity - applied
    travel = elapsed_s * applied + lag_s * (1.0 - decay) * difference
    return offset + elapsed_s * commanded - travel, applied + decay * difference

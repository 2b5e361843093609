"""An arm that answers late: how much further it will go by what it has been told already.

A command that is computed as if the arm obeyed at once is late by delay + lag when it acts, and so is what the feedback
sees of it: the tool trails behind a moving target by the acceleration that came meanwhile. With a model of the lateness
(each joint's velocity answers after ``delay_s`` with a first-order lag of ``lag_s``) the commands given so far lead the
joints on by

    lead(t) = integral of (command - velocity of the model) dt

and the control law is applied where the arm is going to be, at the target of that time (Smith, "Closer control of loops
with dead time", Chemical Engineering Progress 53, 1957). Without lateness the lead is zero, and so it is at rest.
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
"""Time over which the target's acceleration is averaged, in latenesses."""


class SmithPredictorSnapshot(NamedTuple):
    """What a :class:`LateArm` remembers; its attributes of the same names."""

    time_ns: int
    ahead: Array
    """The lead, (n,), rad (m)."""
    velocity: Array
    """Of the model, (n,)."""
    obeyed: Array
    """The command that the model obeys, (n,)."""
    told: Array
    """The newest command, (n,)."""
    waiting: tuple[tuple[int, Array], ...]
    """When the model is going to obey which commands."""
    twist_d: Array | None
    """Of the target at the last tick; None at the first."""
    acceleration_d: Array
    """Of the target, averaged, (6,)."""


class LateArm:
    """The model, driven by the commands that are given."""

    def __init__(self, n: int, settings: ControlSettings) -> None:
        self._n = n
        self.begin(0)
        self.configure(settings)

    def configure(self, settings: ControlSettings) -> None:
        """Another lag and delay from now on."""
        self._lag_s, self._delay_ns = settings.arm_lag_s, round(settings.arm_delay_s * NS)
        self.lateness_s = settings.arm_lag_s + settings.arm_delay_s

    def begin(self, time_ns: int) -> None:
        """The arm rests, and nothing has been told to it."""
        self._time_ns = time_ns
        self._ahead, self._velocity = np.zeros(self._n), np.zeros(self._n)
        self._obeyed, self._told = np.zeros(self._n), np.zeros(self._n)
        self._waiting: tuple[tuple[int, Array], ...] = ()
        self._twist_d: Array | None = None
        self._acceleration_d = np.zeros(6)

    def target(self, motion: Motion, interval_s: float) -> Motion:
        """The target of ``motion`` when the arm is going to be there, by its acceleration since the last tick."""
        before = motion.twist_d if self._twist_d is None else self._twist_d
        self._twist_d = motion.twist_d
        later, self._acceleration_d = _ahead_of(motion, before, self._acceleration_d, interval_s, self.lateness_s)
        return later

    def command(self, velocity: Array, time_ns: int) -> None:
        """A command (n,), rad/s (m/s), that stands from now on."""
        if self.lateness_s > 0.0:
            self.lead(time_ns)
            self._told = velocity
            self._waiting = (*self._waiting, (time_ns + self._delay_ns, velocity))

    def lead(self, time_ns: int) -> Array:
        """How far the joints will go beyond where they are now, (n,), rad (m), if told no more than to stop."""
        while self._waiting and self._waiting[0][0] <= time_ns:
            from_ns, command = self._waiting[0]
            self._move(from_ns)
            self._obeyed, self._waiting = command, self._waiting[1:]
        self._move(time_ns)
        return self._ahead

    def _move(self, time_ns: int) -> None:
        elapsed_s = max(time_ns - self._time_ns, 0) / NS
        self._time_ns = max(time_ns, self._time_ns)
        self._ahead, self._velocity = _moved(
            self._ahead, self._velocity, self._obeyed, self._told, elapsed_s, self._lag_s
        )


@compiled
def _ahead_of(
    motion: Motion, twist_before: Array, acceleration: Array, interval_s: float, lateness_s: float
) -> tuple[Motion, Array]:
    """The target ``lateness_s`` after ``motion``, and its averaged acceleration from now on."""
    # Averaged over the lateness: what trembles faster is over when the arm gets there.
    part = 1.0 - math.exp(-interval_s / (SMOOTHING * lateness_s))
    newest = (motion.twist_d - twist_before) / interval_s
    acceleration = acceleration + part * (newest - acceleration)
    change = lateness_s * acceleration
    pose_sd = se3.times(motion.pose_sd, se3.pose_after(lateness_s * (motion.twist_d + 0.5 * change)))
    return Motion(pose_sd, motion.twist_d + change), acceleration


@compiled
def _moved(
    ahead: Array, velocity: Array, obeyed: Array, told: Array, elapsed_s: float, lag_s: float
) -> tuple[Array, Array]:
    """The lead and the model's velocity ``elapsed_s`` later."""
    if lag_s <= 0.0:
        return ahead + elapsed_s * told - elapsed_s * obeyed, obeyed
    left, behind = math.exp(-elapsed_s / lag_s), velocity - obeyed
    went = elapsed_s * obeyed + lag_s * (1.0 - left) * behind
    return ahead + elapsed_s * told - went, obeyed + left * behind

"""Integral action: takes out what a steady disturbance leaves over, and nothing else.

The twist K_i z is added to the feedback, with z the integral of the error log(T_bd) in {b}. With K_p it closes the
error by s^2 + K_p s + K_i = 0: up to K_i = K_p^2 / 4 without oscillation. Against winding up, z stands still while the
arm cannot do what it is told (``frozen``) and, each half for itself, while the feedback is capped; and its twist is
capped itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import cut, length
from ik_node.math.types import Array
from ik_node.settings.groups import ControlSettings

NOTHING = np.zeros(6)
"""Shared: z is never written into, but replaced."""


class IntegralSnapshot(NamedTuple):
    """What :class:`IntegralAction` remembers."""

    value: Array


class IntegralAction:
    """z and what it asks for."""

    def __init__(self) -> None:
        self.value: Array = NOTHING
        """z (6,): m s and rad s, in {b}."""

    def reset(self) -> None:
        """Nothing has been left over."""
        self.value = NOTHING

    def idle(self, control: ControlSettings) -> bool:
        """True where nothing is asked for; what has been left over is then forgotten."""
        if control.gain_integral_linear != 0.0 or control.gain_integral_angular != 0.0:
            return False
        self.value = NOTHING
        return True

    def twist(self, error_b: Array, elapsed_s: float, frozen: bool, control: ControlSettings) -> Array:
        """K_i z (6,) in {b}, after ``elapsed_s`` with the error ``error_b`` (6,).

        ``frozen``: the last twist was scaled down, lost a direction, or the robot does not follow.
        """
        self.value, twist = _integrated(
            self.value,
            error_b,
            elapsed_s,
            frozen,
            _Half(
                control.gain_integral_linear,
                control.max_integral_linear,
                control.gain_linear,
                control.max_feedback_linear,
            ),
            _Half(
                control.gain_integral_angular,
                control.max_integral_angular,
                control.gain_angular,
                control.max_feedback_angular,
            ),
        )
        return twist


class _Half(NamedTuple):
    gain: float
    cap: float
    """Of the twist."""
    feedback_gain: float
    feedback_cap: float


@compiled
def _integrated(
    value: Array, error_b: Array, elapsed_s: float, frozen: bool, linear: _Half, angular: _Half
) -> tuple[Array, Array]:
    """z from now on, and its twist."""
    z, twist = np.zeros(6), np.zeros(6)
    for first, half in ((0, linear), (3, angular)):
        if half.gain == 0.0:
            continue
        x, y, s = value[first], value[first + 1], value[first + 2]
        a, b, c = error_b[first], error_b[first + 1], error_b[first + 2]
        if not frozen and half.feedback_gain * length((a, b, c)) <= half.feedback_cap:
            x, y, s = cut((x + elapsed_s * a, y + elapsed_s * b, s + elapsed_s * c), half.cap / half.gain)
        z[first], z[first + 1], z[first + 2] = x, y, s
        twist[first : first + 3] = half.gain * z[first : first + 3]
    return z, twist

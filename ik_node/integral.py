"""Integral action: takes out what a steady disturbance leaves over, and nothing else.

The twist K_i z is added to the feedback, with z the integral of the error log(T_bd) in {b}. With K_p it closes the
error by s^2 + K_p s + K_i = 0: up to K_i = K_p^2 / 4 without oscillation. Against winding up, z stands still while the
arm cannot do what it is told (``frozen``) and, each half for itself, while the feedback is capped; and its twist is
capped itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.se3 import Array
from ik_node.settings import ControlSettings


class IntegralMemory(NamedTuple):
    """What :class:`IntegralAction` remembers."""

    value: Array


class IntegralAction:
    """z and what it asks for."""

    def __init__(self) -> None:
        self.value: Array = np.zeros(6)
        """z (6,): m s and rad s, in {b}."""

    def reset(self) -> None:
        """Nothing has been left over."""
        self.value = np.zeros(6)

    def twist(self, error_b: Array, elapsed_s: float, frozen: bool, control: ControlSettings) -> Array:
        """K_i z (6,) in {b}, after ``elapsed_s`` with the error ``error_b`` (6,).

        ``frozen``: the last twist was scaled down, lost a direction, or the robot does not follow.
        """
        result = np.zeros(6)
        halves = (
            (slice(0, 3), control.gain_linear, control.max_feedback_linear),
            (slice(3, 6), control.gain_angular, control.max_feedback_angular),
        )
        gains = (control.gain_integral_linear, control.gain_integral_angular)
        caps = (control.max_integral_linear, control.max_integral_angular)
        for (half, proportional, most), gain, cap in zip(halves, gains, caps, strict=True):
            if gain == 0.0:
                self.value[half] = 0.0
                continue
            error = error_b[half]
            if not frozen and proportional * float(np.sqrt(error @ error)) <= most:
                self.value[half] = _capped(self.value[half] + elapsed_s * error, cap / gain)
            result[half] = gain * self.value[half]
        return result


def _capped(vector: Array, longest: float) -> Array:
    size = float(np.sqrt(vector @ vector))
    return vector * (longest / size) if size > longest else vector

"""Integral action: removes the steady-state error due to constant disturbances.

The twist K_i z is added to the feedback, with z the integral of the error log(T_bd) in {b}. With K_p the error dynamics
are s^2 + K_p s + K_i = 0, without oscillation up to K_i = K_p^2 / 4. Anti-windup: z is not integrated while the command
is limited (``frozen``) or, separately for the linear and the angular part, while the feedback is saturated; and K_i z
is bounded.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.quaternion import clamp_norm, length
from ik_node.math.types import Array
from ik_node.settings.groups import ControlSettings

MAX_INTEGRAL_TWIST = (0.05, 0.2)
"""Maximum speed that integral action commands [linear m/s, angular rad/s]."""
ZERO = np.zeros(6)
"""Shared initial z; z is replaced, never modified in place."""


class IntegralSnapshot(NamedTuple):
    """Attributes of an :class:`IntegralAction`."""

    value: Array


class IntegralAction:
    """Integrator with anti-windup."""

    def __init__(self) -> None:
        self.value: Array = ZERO
        """z, (6,), m s and rad s, in {b}."""

    def reset(self) -> None:
        """Sets z to zero."""
        self.value = ZERO

    def idle(self, control: ControlSettings) -> bool:
        """True when both gains are zero; z is then set to zero."""
        if any(control.integral_gain):
            return False
        self.value = ZERO
        return True

    def twist(self, error_b: Array, elapsed_s: float, frozen: bool, control: ControlSettings) -> Array:
        """Integrates the error and returns the integral twist.

        Args:
            error_b: log(T_bd), (6,), m and rad.
            elapsed_s: Time since the last control step, s.
            frozen: True when the last twist was scaled or truncated; z then keeps its value.
            control: Gains and bounds.

        Returns:
            K_i z, (6,), m/s and rad/s, in {b}.
        """
        self.value, twist = _integrated(
            self.value,
            error_b,
            elapsed_s,
            frozen,
            *(
                _Half(
                    control.integral_gain[half],
                    MAX_INTEGRAL_TWIST[half],
                    control.gain[half],
                    control.max_feedback_twist[half],
                )
                for half in (0, 1)
            ),
        )
        return twist


class _Half(NamedTuple):
    """Settings of the linear or the angular part."""

    gain: float
    max_speed: float
    """Bound of K_i z."""
    feedback_gain: float
    max_feedback: float


@compiled
def _integrated(
    value: Array, error_b: Array, elapsed_s: float, frozen: bool, linear: _Half, angular: _Half
) -> tuple[Array, Array]:
    """New z, and K_i z."""
    z, twist = np.zeros(6), np.zeros(6)
    for first, half in ((0, linear), (3, angular)):
        if half.gain == 0.0:
            continue
        x, y, s = value[first], value[first + 1], value[first + 2]
        a, b, c = error_b[first], error_b[first + 1], error_b[first + 2]
        if not frozen and half.feedback_gain * length((a, b, c)) <= half.max_feedback:
            x, y, s = clamp_norm((x + elapsed_s * a, y + elapsed_s * b, s + elapsed_s * c), half.max_speed / half.gain)
        z[first], z[first + 1], z[first + 2] = x, y, s
        twist[first : first + 3] = half.gain * z[first : first + 3]
    return z, twist

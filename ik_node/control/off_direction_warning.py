"""Warning about a tool that leaves the direction of its twist, with its speed and the limit that causes it.

The speed is the highest one since the warning began, rounded up in the series 1, 2, 5, and the limit is that of this
speed, so that the text changes a few times only while the warning lasts.
"""

from __future__ import annotations

from math import floor, inf, log10
from typing import NamedTuple

import numpy as np

from ik_node.control.status import RELEASE_S
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import OFF_DIRECTION
from ik_node.math.types import Array

MIN_RATIO = 0.01
"""Fraction of the twist below which motion off its direction is not reported ..."""

MIN_SPEED = 1e-3
"""... and speed below which it is not, m/s (angular speeds times the characteristic length)."""


class OffDirectionWarning(NamedTuple):
    """The warning in force."""

    text: str = ""
    """Empty for none."""
    rounded: float = 0.0
    """The speed in the text, m/s."""
    until_ns: int = 0
    """Monotonic time until which it is reported."""


NO_WARNING = OffDirectionWarning()


def updated_warning(
    before: OffDirectionWarning,
    time_ns: int,
    off_direction: Array,
    twist: Array,
    limits: tuple[str, ...],
    characteristic_length: float,
) -> OffDirectionWarning:
    """The warning after a control step.

    Args:
        before: The warning after the last one.
        time_ns: Monotonic time.
        off_direction: J qd - s V_f, (6,), m/s and rad/s.
        twist: V, (6,).
        limits: The limits that cause it, the most effective first.
        characteristic_length: Factor of angular speeds, m.
    """
    if before.text and time_ns >= before.until_ns:
        before = NO_WARNING
    row_scale = np.repeat((1.0, characteristic_length), 3)
    speed, wanted = (float(np.linalg.norm(row_scale * vector)) for vector in (off_direction, twist))
    if not limits or speed <= max(MIN_SPEED, MIN_RATIO * wanted):
        return before
    until_ns = time_ns + round(RELEASE_S * NS)
    if speed <= before.rounded:
        return before._replace(until_ns=until_ns)
    rounded = _rounded_up(speed)
    return OffDirectionWarning(f"{OFF_DIRECTION} by up to {rounded:g} m/s: {limits[0]}", rounded, until_ns)


def _rounded_up(value: float) -> float:
    """The next larger number of the series 1, 2, 5."""
    power = 10.0 ** floor(log10(value)) if value < inf else inf
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value))

"""Bounds of the reference motion of each kind of target, as fractions of the parameters ``target.max_*``."""

from __future__ import annotations

from typing import NamedTuple

from ik_node.settings.groups import Pair, TargetSettings
from ik_node.targets.jerk_limited_filter import Bounds, MotionBounds

CATCH_UP_FRACTION: Pair = (0.5, 1.0)
"""Fraction of the maximum speed that the error of a stream alone may command [linear, angular]: how jumps are
approached."""
PATH_ACCELERATION_FRACTION: Pair = (0.05, 0.08)
"""Fraction of the maximum acceleration along a path without time stamps [linear, angular]."""


class BoundFractions(NamedTuple):
    """Fractions [linear, angular] of ``target.max_speed``, ``target.max_acceleration`` and ``target.max_jerk``."""

    speed: Pair
    acceleration: Pair
    jerk: Pair


JOG = BoundFractions((0.25, 0.4), (0.2, 0.32), (0.08, 0.04))
"""Jogging: 0.25 m/s and 1 rad/s at default settings."""
APPROACH = BoundFractions((0.2, 0.32), (0.2, 0.32), (0.08, 0.04))
"""The way to a path: 0.2 m/s and 0.8 rad/s at default settings."""


def stream_bounds(settings: TargetSettings) -> MotionBounds:
    """Bounds of the reference of a stream of poses: the whole of the parameters."""
    linear, angular = (
        Bounds(
            settings.max_speed[half],
            settings.max_acceleration[half],
            settings.max_jerk[half],
            CATCH_UP_FRACTION[half] * settings.max_speed[half],
        )
        for half in (0, 1)
    )
    return MotionBounds(linear, angular)


def motion_bounds(settings: TargetSettings, fractions: BoundFractions) -> MotionBounds:
    """Bounds of a motion that may use ``fractions`` of the parameters, with the whole speed for the error."""
    linear, angular = (
        bounds_from_rest(
            fractions.speed[half] * settings.max_speed[half],
            fractions.acceleration[half] * settings.max_acceleration[half],
            fractions.jerk[half] * settings.max_jerk[half],
        )
        for half in (0, 1)
    )
    return MotionBounds(linear, angular)


def bounds_from_rest(speed: float, acceleration: float, jerk: float) -> Bounds:
    """Bounds of one half whose error may command the whole speed."""
    return Bounds(speed, acceleration, jerk, speed)

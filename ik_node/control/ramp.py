"""Ramp of the joint velocity to zero, along a straight line in joint space, within the acceleration limits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import NS
from ik_node.math.types import Array


class Ramp(NamedTuple):
    """Linear ramp of a joint velocity to zero; all joints keep their ratio, so the tool stays close to its path."""

    velocity: Array
    """Joint velocity at the start, (n,), rad/s (m/s)."""
    start_ns: int
    duration_s: float

    def at(self, time_ns: int) -> Array:
        """Joint velocity at a monotonic time, (n,), rad/s (m/s)."""
        elapsed_s = (time_ns - self.start_ns) / NS
        if elapsed_s >= self.duration_s:
            return np.zeros_like(self.velocity)
        return self.velocity * (1.0 - max(elapsed_s, 0.0) / self.duration_s)

    def finished(self, time_ns: int) -> bool:
        """True when the velocity is zero at a monotonic time."""
        return (time_ns - self.start_ns) / NS >= self.duration_s


def ramp_to_zero(velocity: Array, acceleration: Array, time_ns: int) -> Ramp:
    """Shortest ramp from ``velocity`` (n,) within ``acceleration`` limits (n,); starts at a monotonic time."""
    return Ramp(velocity.copy(), time_ns, float(np.max(np.abs(velocity) / acceleration)))

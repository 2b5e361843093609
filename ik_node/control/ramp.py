"""Coming to rest on the shortest straight line in joint space that the acceleration limits allow."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.clock import NS
from ik_node.math.types import Array


class Ramp(NamedTuple):
    """A ramp from a joint velocity to zero, all joints in proportion, so that the tool's path does not bend."""

    velocity: Array
    """Joint velocity at the start, (n,)."""
    start_ns: int
    duration_s: float

    def at(self, time_ns: int) -> Array:
        """Joint velocity at a monotonic time; zero from the end on."""
        elapsed_s = (time_ns - self.start_ns) / NS
        if elapsed_s >= self.duration_s:
            return np.zeros_like(self.velocity)
        return self.velocity * (1.0 - max(elapsed_s, 0.0) / self.duration_s)

    def finished(self, time_ns: int) -> bool:
        """True once the velocity is zero."""
        return (time_ns - self.start_ns) / NS >= self.duration_s


def ramp_to_zero(velocity: Array, acceleration: Array, time_ns: int) -> Ramp:
    """The ramp from ``velocity`` (n,) under ``acceleration`` limits (n,); the slowest joint sets its length."""
    return Ramp(velocity.copy(), time_ns, float(np.max(np.abs(velocity) / acceleration)))

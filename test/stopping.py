"""Pairs that cannot stop any more: what a query with limits must find."""

from __future__ import annotations

import numpy as np

from ik_node.collision.distance_bounds import Limits
from ik_node.collision.distance_kernels import NearPairs
from ik_node.math.types import Array

LIMITS = Limits(0.0, 0.0, own_stop=0.002, stop=0.01, damper_range=0.5, deceleration=1.0, hold_s=0.01)


def pairs_that_must_stop(near: NearPairs, qd: Array, change: Array) -> set[int]:
    """Pairs whose distance is less than they need to stop, at velocities within ``change`` (n,) of ``qd`` (n,).

    The speed of approach is that of their own gradients, not a bound of it.
    """
    speed = np.maximum(np.abs(near.slope) @ change - near.slope @ qd - near.drift, 0.0)
    needed = speed * (0.5 * speed / LIMITS.deceleration + 1.5 * LIMITS.hold_s)
    needed += np.where(near.self_collision > 0.0, LIMITS.own_stop, LIMITS.stop)
    return set(near.pair[near.distance < np.minimum(needed, LIMITS.damper_range)].tolist())

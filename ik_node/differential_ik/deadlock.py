"""Deadlock: a limit blocks the direction of a twist, and the arm stands still.

The direction of the twist is kept for ``TIMEOUT_S``. Then it is released: the command blends into the joint velocity
that comes nearest to the twist in any direction. Without this a limit in the way of the direction blocks the arm for
ever.
"""

from __future__ import annotations

import numpy as np

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import quadratic_program
from ik_node.math.numerics import smoothstep
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds

MIN_TASK_SCALE = 0.05
"""An arm that executes a smaller fraction of its twist is stalled."""

MIN_TWIST = 1e-3
"""Twists without an entry beyond this, m/s or rad/s, do not count as stalled."""

TIMEOUT_S = 1.0
"""For how long the direction of the twist is kept while the arm is stalled."""

RELEASE_S = 0.5
"""Duration of the transition to the released direction."""


def stalled_time(before_s: float, task_scale: float, max_entry: float, elapsed_s: float) -> float:
    """For how long the arm has been stalled, s.

    Args:
        before_s: The value of the last control step, s.
        task_scale: Fraction of the twist that is executed.
        max_entry: Largest absolute entry of the twist, m/s or rad/s.
        elapsed_s: Time since the last control step, s.
    """
    if task_scale < MIN_TASK_SCALE and max_entry > MIN_TWIST:
        return min(before_s + elapsed_s, TIMEOUT_S + RELEASE_S)
    return max(before_s - elapsed_s, 0.0)


def release_direction(
    velocity: Array,
    jacobian: Array,
    twist: Array,
    row_scale: Array,
    bounds: JointBounds,
    dampers: VelocityDampers | None,
    stalled_s: float,
) -> Array:
    """``velocity`` (n,) blended, over the time ``stalled_s``, into the one that comes nearest to the twist."""
    rows, least = (np.zeros((0, len(velocity))), np.zeros(0)) if dampers is None else dampers[:2]
    scaled = row_scale[:, None] * jacobian
    nearest = quadratic_program.nearest_to_twist(scaled, row_scale * twist, bounds.lo, bounds.hi, rows, least)
    if nearest is None:
        return velocity
    ratio = smoothstep((stalled_s - TIMEOUT_S) / RELEASE_S)
    return np.asarray((1.0 - ratio) * velocity + ratio * nearest)

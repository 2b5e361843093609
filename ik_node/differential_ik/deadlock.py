"""An arm that a limit holds although a twist is asked for: its direction is kept for a while, and then let go.

A limit that stands in the way of the direction would else hold the arm for ever.
"""

from __future__ import annotations

import numpy as np

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import quadratic_program
from ik_node.differential_ik.singular_directions import smooth_step
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds

STANDSTILL = 0.05
"""An arm that does less than this part of a twist stands before a limit."""

LEAST_TWIST = 1e-3
"""Twists with no entry beyond this, m/s or rad/s, ask for too little to say so."""

PATIENCE_S = 1.0
"""For so long the direction is kept all the same."""

LETTING_GO_S = 0.5
"""How long the change takes then."""


def blocked(before_s: float, part: float, fastest: float, elapsed_s: float) -> float:
    """For how long the arm has been standing, s; ``before_s``: at the last tick, ``elapsed_s`` ago.

    ``part``: how much of the twist it does; ``fastest``: the twist's largest entry, m/s or rad/s.
    """
    if part < STANDSTILL and fastest > LEAST_TWIST:
        return min(before_s + elapsed_s, PATIENCE_S + LETTING_GO_S)
    return max(before_s - elapsed_s, 0.0)


def let_go(
    velocity: Array,
    jacobian: Array,
    twist: Array,
    row_scale: Array,
    bounds: JointBounds,
    dampers: VelocityDampers | None,
    blocked_s: float,
) -> Array:
    """``velocity`` (n,) on its way to the one that comes nearest to the twist, its direction given up."""
    rows, least = (np.zeros((0, len(velocity))), np.zeros(0)) if dampers is None else dampers[:2]
    scaled = row_scale[:, None] * jacobian
    nearest = quadratic_program.nearest_to_twist(scaled, row_scale * twist, bounds.lo, bounds.hi, rows, least)
    if nearest is None:
        return velocity
    part = smooth_step((blocked_s - PATIENCE_S) / LETTING_GO_S)
    return np.asarray((1.0 - part) * velocity + part * nearest)

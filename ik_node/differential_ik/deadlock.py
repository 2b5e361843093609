"""Deadlock: the arm stands still although its twist is not zero.

A limit blocks the direction of the twist, or a singularity truncates nearly all of it. Direction and truncation are
kept for ``TIMEOUT_S``. Then they are released: the command blends into the joint velocity that comes nearest to the
twist in any direction. Without this the arm would stand still for ever.

Towards a pose at rest the twist is proportional to the error of the pose, and the released command is a
Levenberg-Marquardt step of its square within the limits: the tool comes nearer until no small motion that the limits
permit reduces the error.
"""

from __future__ import annotations

import math

import numpy as np

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import quadratic_program
from ik_node.math.numerics import smoothstep
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds

MIN_FRACTION = 0.05
"""An arm that executes a smaller fraction of its twist is stalled."""

MIN_TWIST = 1e-3
"""Twists without an entry beyond this, m/s or rad/s, do not count as stalled."""

TIMEOUT_S = 1.0
"""For how long the direction of the twist is kept while the arm is stalled."""

RELEASE_S = 0.5
"""Duration of the transition to the released direction."""

SINGULAR_RATE = 0.3
"""Highest rate in a singular direction after the release, rad/s (m/s); the damping results from it. It bounds the
effect of noise in the measured positions, too."""

MIN_DAMPING_M, MAX_DAMPING_FRACTION = 0.003, 0.01
"""The damping is at least the square of the first, and at most this fraction of the mean squared singular value."""


def executed_fraction(twist: Array, executed: Array, row_scale: Array) -> float:
    """The length of the executed twist, s V_f, relative to that of the twist V.

    Args:
        twist: V, (6,).
        executed: s V_f, (6,).
        row_scale: D, (6,).
    """
    wanted, done = row_scale * twist, row_scale * executed
    return math.sqrt(float(done @ done) / max(float(wanted @ wanted), 1e-300))


def is_truncated(twist: Array, followed: Array, row_scale: Array) -> bool:
    """True if a singularity truncates nearly all of the twist; :func:`executed_fraction` has the arguments."""
    return executed_fraction(twist, followed, row_scale) < MIN_FRACTION


def stalled_time(before_s: float, fraction: float, max_entry: float, elapsed_s: float) -> float:
    """For how long the arm has been stalled, s.

    Args:
        before_s: The value of the last control step, s.
        fraction: Fraction of the twist that is executed.
        max_entry: Largest absolute entry of the twist, m/s or rad/s.
        elapsed_s: Time since the last control step, s.
    """
    if fraction < MIN_FRACTION and max_entry > MIN_TWIST:
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
    scaled, wanted = row_scale[:, None] * jacobian, row_scale * twist
    most = MAX_DAMPING_FRACTION * float(np.sum(scaled * scaled)) / len(velocity)
    damping = min(max(float(wanted @ wanted) / (2.0 * SINGULAR_RATE) ** 2, MIN_DAMPING_M**2), most)
    nearest = quadratic_program.nearest_to_twist(scaled, wanted, bounds.lo, bounds.hi, rows, least, damping)
    if nearest is None:
        return velocity
    ratio = smoothstep((stalled_s - TIMEOUT_S) / RELEASE_S)
    return np.asarray((1.0 - ratio) * velocity + ratio * nearest)

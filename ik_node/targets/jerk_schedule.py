"""Plans: the jerks that the twist of the last tick promised, to be carried out before anything new is thought of.

A plan is an array (k, 7), a row per jerk: linear [m/s3], angular [rad/s3], and how long it is held [s].
"""

from __future__ import annotations

from math import ceil

import numpy as np

from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import Jerk, RigidMotion, integrate

LONGEST_STEP_S = 0.004
"""A jerk is held no longer than this; longer intervals are cut."""
EMPTY_SCHEDULE = np.zeros((1, 7))
"""A plan that lasts no time."""


@compiled
def no_schedule() -> Array:
    """:data:`EMPTY_SCHEDULE`; compiled functions see a global array as one that cannot be written, another type."""
    return np.zeros((1, 7))


@compiled
def empty_schedule(duration_s: float) -> Array:
    """Rows for the steps into which ``duration_s`` is cut, their jerks unset."""
    steps = max(1, ceil(duration_s / LONGEST_STEP_S - 1e-9))
    schedule = np.empty((steps, 7))
    schedule[:, 6] = duration_s / steps
    return schedule


@compiled
def write_jerk(row: Array, jerk: Jerk) -> None:
    """``jerk`` into one row of a plan, which says for how long."""
    for i in range(3):
        row[i], row[3 + i] = jerk.linear[i], jerk.angular[i]


@compiled
def executed(motion: RigidMotion, schedule: Array, elapsed_s: float) -> tuple[RigidMotion, float]:
    """``motion`` after as much of ``schedule`` as there is time for, and the time left after it."""
    for row in schedule:
        if row[6] > 0.0 and elapsed_s > 0.0:
            part_s = min(row[6], elapsed_s)
            jerk = Jerk((row[0], row[1], row[2]), (row[3], row[4], row[5]), part_s)
            motion = integrate(motion, jerk, part_s)
            elapsed_s -= part_s
    return motion, elapsed_s

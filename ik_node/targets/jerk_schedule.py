"""Jerk schedules: the jerks of the last twist, executed before new ones are computed.

A schedule is an array (k, 7) with a row per jerk: linear [m/s3], angular [rad/s3], duration [s].
"""

from __future__ import annotations

from math import ceil

import numpy as np

from ik_node.jit import compiled
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import Jerk, RigidMotion, integrate

LONGEST_STEP_S = 0.0025
"""Longest duration of a jerk; longer intervals are divided. Short enough for the largest gains of the cascade."""
EMPTY_SCHEDULE = np.zeros((1, 7))
"""A schedule without duration."""


@compiled
def no_schedule() -> Array:
    """:data:`EMPTY_SCHEDULE`; compiled functions treat a global array as read-only, which is another type."""
    return np.zeros((1, 7))


@compiled
def empty_schedule(duration_s: float) -> Array:
    """A schedule with the steps of ``duration_s``; the jerks are not set."""
    steps = max(1, ceil(duration_s / LONGEST_STEP_S - 1e-9))
    schedule = np.empty((steps, 7))
    schedule[:, 6] = duration_s / steps
    return schedule


@compiled
def write_jerk(row: Array, jerk: Jerk) -> None:
    """Writes ``jerk`` into one row, whose duration is set."""
    for i in range(3):
        row[i], row[3 + i] = jerk.linear[i], jerk.angular[i]


@compiled
def executed(motion: RigidMotion, schedule: Array, elapsed_s: float) -> tuple[RigidMotion, float]:
    """The motion after ``elapsed_s`` of the schedule, and the time that remains after its end."""
    for row in schedule:
        if row[6] > 0.0 and elapsed_s > 0.0:
            part_s = min(row[6], elapsed_s)
            jerk = Jerk((row[0], row[1], row[2]), (row[3], row[4], row[5]), part_s)
            motion = integrate(motion, jerk, part_s)
            elapsed_s -= part_s
    return motion, elapsed_s

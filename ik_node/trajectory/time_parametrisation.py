"""Times for a path that came without."""

from __future__ import annotations

import numpy as np

from ik_node.errors import TargetRefused
from ik_node.se3 import Array
from ik_node.settings import PathSettings
from ik_node.trajectory.knot_rates import REPEATED, through_poses
from ik_node.trajectory.rigid_spline import RigidSpline
from ik_node.trajectory.rotations import Quaternion, length
from ik_node.trajectory.so3 import turns_between

SAMPLES_PER_INTERVAL = 8
"""Points between two poses at which speeds and accelerations are looked at."""


def spaced(positions: Array, orientations: tuple[Quaternion, ...], settings: PathSettings) -> tuple[Array, list[int]]:
    """Times [s] of the poses that remain when repeated ones are left out, and their numbers.

    The motion through them stays within the speeds and accelerations of ``settings``; raises TargetRefused where all
    poses are the same.
    """
    linear = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    angular = np.linalg.norm(turns_between(orientations), axis=1)
    kept = [0, *(np.flatnonzero((linear > REPEATED) | (angular > REPEATED)) + 1).tolist()]
    if len(kept) < 2:
        raise TargetRefused("a path without times, of poses that are all the same")
    moves = np.diff(positions[kept], axis=0)
    turns = turns_between(tuple(orientations[index] for index in kept))
    steps = np.maximum(
        np.linalg.norm(moves, axis=1) / settings.linear_speed, np.linalg.norm(turns, axis=1) / settings.angular_speed
    )
    times_s = np.concatenate(([0.0], np.cumsum(steps)))
    spline = RigidSpline(through_poses(times_s, positions[kept], tuple(orientations[i] for i in kept), False))
    return times_s * _stretch(spline, times_s, settings), kept


def _stretch(spline: RigidSpline, times_s: Array, settings: PathSettings) -> float:
    """By how much longer the motion must take to stay within the bounds."""
    parts = np.arange(SAMPLES_PER_INTERVAL) / SAMPLES_PER_INTERVAL
    looked_at = (times_s[:-1, None] + np.diff(times_s)[:, None] * parts).ravel()
    longest = 1.0
    for time_s in looked_at.tolist():
        motion = spline.motion(time_s)
        longest = max(
            longest,
            length(motion.velocity) / settings.linear_speed,
            length(motion.rate) / settings.angular_speed,
            (length(motion.acceleration) / settings.linear_acceleration) ** 0.5,
            (length(motion.angular_acceleration) / settings.angular_acceleration) ** 0.5,
        )
    return longest

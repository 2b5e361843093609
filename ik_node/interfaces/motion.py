"""Desired motion, the output of every source of targets and the input of the controller."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ik_node.math.types import Array

NO_POSE = np.full((4, 4), np.nan)
"""Pose when it is unknown, (4, 4)."""


class Motion(NamedTuple):
    """A desired motion over one control interval."""

    pose_sd: Array
    """T_sd at the start of the interval, (4, 4)."""
    twist_d: Array
    """Mean body twist of the desired frame over the interval, (6,), in {d}, linear part first, m/s and rad/s."""


class Trajectory(Protocol):
    """A motion that is known in advance: target of a demonstration and reference of a report."""

    @property
    def duration_s(self) -> float:
        """Duration, s; the motion starts and ends at rest."""

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""

"""What every source of targets hands to the controller."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from ik_node.math.types import Array

NO_POSE = np.full((4, 4), np.nan)
"""Where the tool is, while nobody says so."""


class Motion(NamedTuple):
    """A desired motion over one control interval."""

    pose_sd: Array
    """T_sd at the interval's start, (4, 4)."""
    twist_d: Array
    """Mean body twist of the desired frame over the interval, written in {d}, (v, omega), m/s and rad/s."""


class Trajectory(Protocol):
    """A motion that is known ahead: what a demonstration follows and what a report compares with."""

    @property
    def duration_s(self) -> float:
        """Length in seconds; the motion rests at its ends."""

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); held at its ends outside 0..duration_s."""

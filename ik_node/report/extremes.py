"""Extreme values of a run: smallest distance to a joint limit, largest multiplier."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.recording.run import Run


class JointLimitMargin(NamedTuple):
    """Smallest distance of a joint to a position limit."""

    least: float
    """rad (m); negative beyond the limit, NaN if no joint has a limit."""
    joint: str
    time_s: float


class MultiplierMaxima(NamedTuple):
    """Largest norms of both terms of the multiplier, as recorded: the potential term includes the gain k."""

    task_linear_max: float
    """N s for a mass-weighted method."""
    task_angular_max: float
    """N m s for a mass-weighted method."""
    potential_linear_max: float
    potential_angular_max: float


def joint_limit_margin(run: Run) -> JointLimitMargin:
    """Compares measured positions with the limits at the start of the run."""
    distances = np.minimum(run.q - run.lower, run.upper - run.q)
    finite = np.isfinite(distances)
    if not finite.any():
        return JointLimitMargin(math.nan, "", math.nan)
    row, joint = np.unravel_index(int(np.where(finite, distances, np.inf).argmin()), distances.shape)
    return JointLimitMargin(float(distances[row, joint]), run.joints[int(joint)], float(run.times_s[row]))


def multiplier_maxima(run: Run) -> MultiplierMaxima:
    """Norms over all ticks; NaN if no tick computed a multiplier."""
    task, potential = run.multiplier_task, run.multiplier_potential
    return MultiplierMaxima(
        _max_norm(task[:, :3]), _max_norm(task[:, 3:]), _max_norm(potential[:, :3]), _max_norm(potential[:, 3:])
    )


def _max_norm(vectors: Array) -> float:
    norms = np.linalg.norm(vectors, axis=1)
    finite = norms[np.isfinite(norms)]
    return float(finite.max()) if len(finite) else math.nan

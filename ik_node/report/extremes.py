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
    """Largest norms of both terms of the multiplier; the potential term is divided by the gain k."""

    task_linear_max: float
    """N s for a mass-weighted method."""
    task_angular_max: float
    """N m s for a mass-weighted method."""
    potential_linear_max: float
    """N."""
    potential_angular_max: float
    """N m."""


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
    task, potential = run.multiplier_task, potential_wrench(run)
    return MultiplierMaxima(
        _max_norm(task[:, :3]), _max_norm(task[:, 3:]), _max_norm(potential[:, :3]), _max_norm(potential[:, 3:])
    )


def potential_wrench(run: Run) -> Array:
    """The potential term of the multiplier divided by the gain k: a wrench on the tool.

    k is the parameter ``gradient_gain`` at each control step. Where ``null_space_speed`` reduced k, the result is the
    wrench times that reduction, because the reduced k is not recorded.

    Returns:
        (k, 6), N and N m; NaN where the gain is 0 or not recorded.
    """
    gain = gradient_gains(run)
    with np.errstate(divide="ignore", invalid="ignore"):
        result: Array = run.multiplier_potential / np.where(gain > 0.0, gain, np.nan)[:, None]
    return result


def gradient_gains(run: Run) -> Array:
    """The gain k at each control step, (k,); NaN where it was not recorded."""
    gains = np.full(len(run.times_s), _number(run.settings.get("gradient_gain")))
    for time_s, changed in run.setting_changes or ():
        if "gradient_gain" in changed:
            gains[run.times_s >= time_s] = _number(changed["gradient_gain"])
    return gains


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else np.nan


def _max_norm(vectors: Array) -> float:
    norms = np.linalg.norm(vectors, axis=1)
    finite = norms[np.isfinite(norms)]
    return float(finite.max()) if len(finite) else math.nan

"""The least and the most of a run that the report's figures do not name: joints near limits, and the multiplier."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array
from ik_node.recording.run import Run


class Margin(NamedTuple):
    """The joint that came nearest to a position limit."""

    least: float
    """Distance left, rad (m); negative beyond the limit, NaN where no joint has one."""
    joint: str
    time_s: float


class Multiplier(NamedTuple):
    """Greatest norms of the multiplier's two terms, as recorded: the potential's still times k."""

    task_linear_max: float
    """N s for a method that weighs by mass."""
    task_angular_max: float
    """N m s likewise."""
    potential_linear_max: float
    potential_angular_max: float


def margin(run: Run) -> Margin:
    """Measured positions against the limits at the start of the run."""
    left = np.minimum(run.q - run.lower, run.upper - run.q)
    known = np.isfinite(left)
    if not known.any():
        return Margin(math.nan, "", math.nan)
    row, joint = np.unravel_index(int(np.where(known, left, np.inf).argmin()), left.shape)
    return Margin(float(left[row, joint]), run.joints[int(joint)], float(run.times_s[row]))


def multiplier(run: Run) -> Multiplier:
    """NaN where no tick computed one."""
    task, potential = run.multiplier_task, run.multiplier_potential
    return Multiplier(_most(task[:, :3]), _most(task[:, 3:]), _most(potential[:, :3]), _most(potential[:, 3:]))


def _most(vectors: Array) -> float:
    norms = np.linalg.norm(vectors, axis=1)
    known = norms[np.isfinite(norms)]
    return float(known.max()) if len(known) else math.nan

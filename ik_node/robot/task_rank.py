"""Which exact components of a task an arm can follow in general, and a tolerance that it can follow.

The rows of the exact components are computed at positions that fill the joint range, with the tool at the target. An
arm can follow them in general if their least singular value is not small at most of the positions; a singularity that
the arm passes is none of that.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import COMPONENTS, FRAMES, TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.screw_chain import KinematicChain, finite_range

POSITIONS = 64
"""Number of joint positions; medians of the singular values differ by some percent from those of 1000."""
LENGTH_M = 0.3
"""Length that converts rotations to comparable translations, m."""
FOLLOWED_M = 0.01
"""Median singular value, m, from which a direction can be followed. The SO-101 has 0.004 for position and pointing,
which are dependent but for an offset of 8 mm in its wrist, and 0.04 for position, pitch and roll."""


class TaskRank(NamedTuple):
    """What an arm can follow of a task."""

    exact: int
    """Number of exact components."""
    rank: int
    """Number of these that can be followed in general."""
    singular_values: Array
    """Medians of the singular values of the exact rows, (exact,), m, largest first; angular rows times 0.3 m."""
    proposal: TaskTolerance | None
    """A tolerance of which all exact components can be followed; None if it is not needed, or if there is none."""

    @property
    def followed(self) -> bool:
        """Whether all exact components can be followed in general."""
        return self.rank == self.exact

    def text(self, tolerance: TaskTolerance) -> str:
        """One line: what of ``tolerance`` cannot be followed, and the proposal; empty if all can be followed."""
        if self.followed:
            return ""
        fact = f"the arm can follow {self.rank} of {self.exact} exact components in general"
        if self.proposal is None:
            return fact
        freed = [name for name, free in zip(COMPONENTS, self.proposal.free & tolerance.exact, strict=True) if free]
        if freed:
            fact += f"; {' '.join(freed)} in the frame {self.proposal.frame} cannot be followed beside the others"
        return f"{fact}; proposed tolerance: {self.proposal.text()} in the frame {self.proposal.frame}"


def task_rank(
    chain: KinematicChain, tolerance: TaskTolerance, proposes: bool = True, free: NDArray[np.intp] | None = None
) -> TaskRank:
    """Computes which exact components an arm can follow in general.

    Args:
        chain: A Robot or a ScrewChain.
        tolerance: The task.
        proposes: False to compute the rank alone, in 1 ms; a proposal takes 20 ms.
        free: Indices of the joints that move, (f,); default: all. The others are locked, at any position.

    Returns:
        The rank, and a proposal if it is less than the number of exact components: in either frame, the choice of exact
        components that keeps the most of the position, then the most components, then those with the largest singular
        value.
    """
    low, high = finite_range(chain)
    points = low + (high - low) * low_discrepancy_points(np.arange(POSITIONS), chain.n)
    kinematics = [chain.evaluate(q) for q in points]
    scale = np.repeat((1.0, LENGTH_M), 3)[:, None]

    def rows(task: TaskTolerance) -> Array:
        form = task.form
        found = [(task_deviation(form, pose, pose).rows_b @ jacobian) * scale for pose, jacobian in kinematics]
        return np.array(found) if free is None else np.array(found)[:, :, free]

    exact = np.flatnonzero(tolerance.exact)
    values = _medians(rows(tolerance)[:, exact]) if len(exact) else np.empty(0)
    rank = int(np.count_nonzero(values > FOLLOWED_M))
    if rank == len(exact) or not proposes:
        return TaskRank(len(exact), rank, values, None)
    best: tuple[tuple[int, int, float], TaskTolerance] | None = None
    for frame in sorted(FRAMES, key=lambda name: name != tolerance.frame):
        frame_rows = rows(TaskTolerance(frame=frame))
        for kept in _subsets(exact):
            least = float(_medians(frame_rows[:, kept])[-1])
            quality = (int(np.count_nonzero(kept < 3)), len(kept), round(least, 9))
            if least > FOLLOWED_M and (best is None or quality > best[0]):
                widths = np.array(tolerance.half_widths)
                widths[np.setdiff1d(exact, kept)] = np.inf
                best = quality, TaskTolerance(widths.tolist(), frame)
    return TaskRank(len(exact), rank, values, None if best is None else best[1])


def _subsets(exact: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    for count in range(len(exact), 0, -1):
        yield from (np.array(kept) for kept in combinations(exact.tolist(), count))


def _medians(rows: Array) -> Array:
    """Medians of the singular values of matrices (k, m, n), (m,), largest first; 0 for those beyond n."""
    values = np.median(np.linalg.svd(rows, compute_uv=False), axis=0)
    return np.pad(values, (0, rows.shape[1] - len(values)))

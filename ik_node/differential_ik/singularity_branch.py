"""The branch of an arm at a singularity: the sign that a singular value does not have.

A singular value decomposition makes every sigma positive and chooses the signs of u and y arbitrarily. Tracked
continuously from one control step to the next, sigma = u' D J y changes its sign when the arm crosses the singularity,
for example when an elbow is bent the other way. An arm stretched by a target out of reach has to return on the branch
that it came from; on the other branch a joint limit or an obstacle may block the way back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array

START_RATIO = 0.25
"""Ratio of sigma to its threshold from which an arm that started at the singularity is on a branch."""


class Branch(NamedTuple):
    """The smallest singular triple at the last control step."""

    left: tuple[float, ...]
    """u, (m,)."""
    right: tuple[float, ...]
    """y, (n,)."""
    crossed: bool
    """True on the other branch than the one that the arm came from."""


def track_branch(before: Branch | None, left: Array, right: Array, ratio: float) -> Branch | None:
    """The branch at the present singular vectors, independent of their signs.

    Args:
        before: The branch at the last control step; None at the first one near this singularity.
        left: u, (m,).
        right: y, (n,).
        ratio: sigma divided by its threshold.

    Returns:
        None until an arm that started at the singularity has left it: it did not come from a branch.
    """
    if before is None:
        if ratio <= START_RATIO:
            return None
        return Branch(tuple(left.tolist()), tuple(right.tolist()), False)
    along, across = float(right @ np.array(before.right)), float(left @ np.array(before.left))
    return Branch(
        tuple((left if across >= 0.0 else -left).tolist()),
        tuple((right if along >= 0.0 else -right).tolist()),
        along * across < 0.0,
    )

"""On which side of a singularity the arm is: the sign that a singular value does not have.

A singular value decomposition makes every sigma positive and chooses the signs of u and y by chance. Followed from tick
to tick by continuity, sigma = u' D J y changes its sign when the singularity is crossed: for an elbow, when it is bent
the other way. An arm that was stretched by a target out of reach has to come back on the side that it came from; on the
other side there may be no way home, since a joint limit or the table is there.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array

CLEAR_OF_IT = 0.25
"""Part of the threshold from which on an arm is on a side of the singularity that it started in."""


class Branch(NamedTuple):
    """The smallest singular triple as it was at the last tick."""

    lost: tuple[float, ...]
    """u, (m,)."""
    motion: tuple[float, ...]
    """y, (n,)."""
    wrong: bool
    """True on the other side than the one that the arm came from."""


def follow_branch(before: Branch | None, lost: Array, motion: Array, part: float) -> Branch | None:
    """The branch at the present u = ``lost`` (m,) and y = ``motion`` (n,), whatever their signs.

    ``before``: at the last tick; None at the first near this singularity. ``part``: sigma over its threshold. None as
    long as an arm that started in the singularity has not left it: then there is no side that it came from.
    """
    if before is None:
        if part <= CLEAR_OF_IT:
            return None
        return Branch(tuple(lost.tolist()), tuple(motion.tolist()), False)
    along, across = float(motion @ np.array(before.motion)), float(lost @ np.array(before.lost))
    return Branch(
        tuple((lost if across >= 0.0 else -lost).tolist()),
        tuple((motion if along >= 0.0 else -motion).tolist()),
        along * across < 0.0,
    )

"""The account of a twist: what the arm does with each part of V.

::

    V = done - off_direction + held_back + truncated
    done = J qd ,  held_back = (1 - s) V_f ,  truncated = V - V_f ,  off_direction = J qd - s V_f

V is the twist of the control law, J the Jacobian in the middle of the interval in which qd is held. ``truncated`` is
given up near a singularity, or deferred: V_f changes no faster than the joints can follow along it. The tool moves
along V_f at the scale s, unless limits permit no multiple of V_f; what they force off that direction is
``off_direction``. The sum has no remainder beyond rounding.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.math.types import Array


class TwistAccount(NamedTuple):
    """The parts of V, (6,) or (k, 6) each, in the frame of V, linear part first, m/s and rad/s."""

    done: Array
    """J qd: the twist of the tool."""
    held_back: Array
    """(1 - s) V_f: the part along V_f that waits, because limits or a singularity slow the arm down."""
    truncated: Array
    """V - V_f: the part that is given up near a singularity, or deferred."""
    off_direction: Array
    """J qd - s V_f: motion that is no multiple of V_f."""

    @property
    def missing(self) -> Array:
        """V - J qd: the part of V that the tool does not do."""
        return np.asarray(self.held_back + self.truncated - self.off_direction)


def twist_account(twist: Array, truncated: Array, off_direction: Array, scale: float | Array) -> TwistAccount:
    """The account of one control step, or of k.

    Args:
        twist: V, (6,) or (k, 6).
        truncated: V - V_f, the same shape.
        off_direction: J qd - s V_f, the same shape.
        scale: s, or (k,).
    """
    s = np.asarray(scale)[..., None]
    regulated = twist - truncated
    return TwistAccount(s * regulated + off_direction, (1.0 - s) * regulated, truncated, off_direction)

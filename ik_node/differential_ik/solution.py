"""What a tick starts from and what it comes to."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.collision.distances import Closest
from ik_node.math.types import Array

NOTHING_LOST = np.zeros(6)
"""V - V_f where nothing is given up; shared, not to be written into."""


class Moment(NamedTuple):
    """Where the arm is and what stands at its motors."""

    q: Array
    """Measured joint positions, (n,), rad (m)."""
    q_middle: Array
    """Where they will be in the middle of the interval in which the next command stands, (n,)."""
    previous: Array
    """The command that stands now, (n,), rad/s (m/s)."""
    elapsed_s: float
    """For how long it has stood."""
    time_ns: int
    """Now, on the monotonic clock."""


class Outcome(NamedTuple):
    """What was chosen, and what it cost. Twists and wrenches (6,) in {b}, linear part first."""

    joint_velocity: Array
    """(n,), rad/s (m/s), finite and within the velocity limits."""
    scale: float
    """The part of V_f that is done: ``pace`` times what the limits let through of it."""
    pace: float
    """How much slower than V the tool goes to pass a singularity on its path."""
    lost_b: Array
    """V - V_f."""
    multiplier_task: Array
    multiplier_potential: Array
    singular_values: Array
    """Of J_b with angular rows times the characteristic length, m."""
    binding: tuple[str, ...]
    """Limits and dampers that bound."""
    conceded: tuple[str, ...]
    """Limits and dampers that gave way to stronger ones."""
    closest: Closest
    """The nearest pair of links, or link and obstacle."""

"""Input and output of :class:`ik_node.differential_ik.solver.DifferentialIkSolver`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.collision.distances import ClosestPair
from ik_node.differential_ik.singularity import START, SingularityState
from ik_node.math.types import Array

NO_TRUNCATION = np.zeros(6)
"""V - V_f if nothing is truncated; shared, must not be modified."""


class ArmState(NamedTuple):
    """State of the arm at one control step."""

    q: Array
    """Measured joint positions, (n,), rad (m)."""
    q_middle: Array
    """Predicted joint positions in the middle of the interval in which the next command is held, (n,), rad (m)."""
    previous: Array
    """The present command, (n,), rad/s (m/s)."""
    elapsed_s: float
    """For how long it has been held, s."""
    time_ns: int
    """Monotonic time, ns."""
    foreseen: bool = False
    """True on a path whose rate is one that the joints can follow, now and ahead."""


class DifferentialIkSolution(NamedTuple):
    """The command and what limits and singularities changed. Twists and wrenches (6,) in {b}, linear part first."""

    joint_velocity: Array
    """(n,), rad/s (m/s), finite and within the velocity limits."""
    task_scale: float
    """s: fraction of V_f that is executed, ``singularity_scale`` times the scale of the limits."""
    singularity_scale: float
    """Factor in (0, 1] by which V is scaled to pass a singularity on the path, or to brake in time along V."""
    truncated_b: Array
    """V - V_f: the part of V that is truncated near a singularity, and ``deferred_b``."""
    off_direction_b: Array
    """J qd - s V_f: the part of the motion that limits force off the direction of V_f; s is ``task_scale``."""
    off_direction_limits: tuple[str, ...]
    """Names of the limits and dampers that cause it, the most effective first; empty up to rounding."""
    multiplier_task: Array
    """First term of the multiplier lambda."""
    multiplier_potential: Array
    """Second term of the multiplier lambda."""
    singular_values: Array
    """Of J_b with angular rows times the characteristic length, descending, m."""
    binding: tuple[str, ...]
    """Names of limits and dampers that bind."""
    relaxed: tuple[str, ...]
    """Names of limits and dampers that are relaxed because stronger ones contradict them."""
    closest: ClosestPair
    """The closest pair of links, or of link and obstacle."""
    deferred_b: Array = NO_TRUNCATION
    """The part of ``truncated_b`` that is deferred: the joints cannot follow the change of V along its direction."""
    present_share: float = 0.0
    """Share of V_f that is the present twist of the tool and not along V."""

    @property
    def progress(self) -> float:
        """Fraction of V that is executed: s less the share of the present twist."""
        return self.task_scale * (1.0 - self.present_share)


class SolverSnapshot(NamedTuple):
    """State of the solver from one control step to the next."""

    singularity: SingularityState
    task_scale: float
    """s of the limits."""
    stalled_s: float
    """For how long limits or a singularity have been keeping the arm from its twist, s."""
    method_fault: str = ""
    """Fault of the own method."""


INITIAL = SolverSnapshot(START, 1.0, 0.0)

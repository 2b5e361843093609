"""The problem of one control step: Jacobian, cost and null-space cap, solved without and with limits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik import constrained
from ik_node.differential_ik.closed_form import ClosedFormSolution, resolve
from ik_node.differential_ik.constrained import ConstrainedSolution
from ik_node.differential_ik.task_rows import TaskBands
from ik_node.math.pseudoinverse import Decomposition, decompose
from ik_node.math.types import Array
from ik_node.robot.joint_limits import JointBounds

MULTIPLIER_FADE_M = 0.02
"""Singular value below which the published multiplier fades out with its direction; the exact one is unbounded."""


@dataclass(frozen=True)
class TaskProblem:
    """What the solutions for several twists have in common."""

    jacobian: Array
    """J, (m, n)."""
    weight: Array | None
    """W, (n, n); None is the identity."""
    gradient: Array | None
    """grad_h, (n,); None is zero."""
    gain: float
    """k, s."""
    row_scale: Array
    """D, (m,)."""
    null_space_cap: Array
    """Largest null-space velocity of each joint, (n,), rad/s (m/s)."""
    known_svd: Decomposition | None
    """Decomposition of D J, if it is known already."""
    bands: TaskBands | None = None
    """Bands of the task; None without any."""

    @cached_property
    def svd(self) -> Decomposition:
        """Decomposition of D J."""
        if self.known_svd is not None:
            return self.known_svd
        return decompose(self.row_scale[:, None] * self.jacobian, "jacobian")

    def with_faded_multipliers(
        self, closed: ClosedFormSolution, jacobian: Array, twist: Array, svd: Decomposition
    ) -> ClosedFormSolution:
        """``closed`` with the multipliers of a twist (m,), and a Jacobian (m, n) with the ``svd``, at a singularity."""
        faded = resolve(
            jacobian,
            twist,
            self.weight,
            self.gradient,
            self.gain,
            threshold=MULTIPLIER_FADE_M,
            row_scale=self.row_scale,
            checked=True,
            svd=svd,
        )
        return closed._replace(multiplier_task=faded.multiplier_task, multiplier_potential=faded.multiplier_potential)

    def solve(
        self, twist: Array, wish: float, bounds: JointBounds, dampers: VelocityDampers | None
    ) -> ConstrainedSolution:
        """The solution under limits.

        Args:
            twist: V_f, (m,).
            wish: The scale that is approached; see :func:`ik_node.differential_ik.constrained.solve`.
            bounds: Limits of this control step.
            dampers: Velocity dampers.
        """
        return constrained.solve(
            self.jacobian,
            twist,
            bounds.lo,
            bounds.hi,
            self.weight,
            self.gradient,
            self.gain,
            row_scale=self.row_scale,
            null_space_cap=self.null_space_cap,
            dampers=dampers,
            svd=self.svd,
            wish=wish,
            bands=self.bands,
        )

"""Locked joints: the problem of a control step without them.

A locked joint ramps from its last velocity to rest at its acceleration limit, whatever the task is. The others solve
the problem of :mod:`ik_node.differential_ik.constrained` in their own coordinates, f for free, l for locked joints::

    minimise    1/2 qd_f' W_ff qd_f + k grad_h_f' qd_f
    subject to  J_f qd_f = s (V_f - J_l qd_l) ,   lo_f <= qd_f <= hi_f ,   N_f qd_f >= c - N_l qd_l

so that the tool stays on its path while a joint ramps, and the optimum is that of the free joints once it rests
(qd_l = 0). Singular values, singularities and null space are those of J_f. Of the whole arm::

    J qd - s V_f = (J_f qd_f - s (V_f - J_l qd_l)) + (1 - s) J_l qd_l
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.avoidance import AvoidanceTerms
from ik_node.collision.velocity_damper import VelocityDampers
from ik_node.differential_ik.constrained import MIN_OFF_DIRECTION
from ik_node.differential_ik.solution import ArmState, DifferentialIkSolution
from ik_node.differential_ik.task_rows import TaskBands, TaskRows
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits, largest_change


class FreeJoints(NamedTuple):
    """The joints that are not locked."""

    joints: tuple[str, ...]
    """Names of all joints."""
    free: NDArray[np.intp]
    """Indices of the free joints."""

    def ramp(self, state: ArmState, limits: MotionLimits) -> Array:
        """Velocities of the locked joints in this control step, (n,), rad/s (m/s); zero for the free ones."""
        change = largest_change(limits.acceleration, state.elapsed_s, limits.dt_max_s)
        velocity = np.sign(state.previous) * np.maximum(np.abs(state.previous) - change, 0.0)
        return self.all_joints(np.zeros(len(self.free)), np.asarray(velocity))

    def all_joints(self, velocity: Array, ramp: Array) -> Array:
        """The velocities of free joints with those of locked ones, (n,)."""
        whole = np.array(ramp)
        whole[self.free] = velocity
        return whole

    def state(self, state: ArmState) -> ArmState:
        """The state of the free joints."""
        q, q_middle, previous = state.q[self.free], state.q_middle[self.free], state.previous[self.free]
        return state._replace(q=q, q_middle=q_middle, previous=previous)

    def limits(self, limits: MotionLimits) -> MotionLimits:
        """The limits of the free joints."""
        return limits._replace(
            lower=limits.lower[self.free],
            upper=limits.upper[self.free],
            velocity=limits.velocity[self.free],
            acceleration=limits.acceleration[self.free],
        )

    def columns(self, matrix: Array) -> Array:
        """Columns of the free joints, (k, f)."""
        return np.ascontiguousarray(matrix[:, self.free])

    def terms(self, terms: AvoidanceTerms | None, ramp: Array) -> AvoidanceTerms | None:
        """Velocity dampers of the free joints."""
        if terms is None:
            return None
        rows, least, names = terms.dampers
        return terms._replace(dampers=VelocityDampers(self.columns(rows), least - rows @ ramp, names))

    def solution(self, found: DifferentialIkSolution, ramp: Array, ramp_twist_b: Array) -> DifferentialIkSolution:
        """The solution of the whole arm.

        Args:
            found: Solution of the free joints.
            ramp: See :meth:`ramp`.
            ramp_twist_b: J_l qd_l in {b}, (6,), m/s and rad/s.
        """
        off_direction = (1.0 - found.task_scale) * ramp_twist_b
        limits = found.off_direction_limits
        if np.abs(off_direction).max() > MIN_OFF_DIRECTION:
            limits += tuple(
                f"lock {name}" for name, rate in zip(self.joints, ramp.tolist(), strict=True) if rate != 0.0
            )
        missing = min(6, len(self.joints)) - len(found.singular_values)
        return found._replace(
            joint_velocity=self.all_joints(found.joint_velocity, ramp),
            off_direction_b=found.off_direction_b + off_direction,
            off_direction_limits=limits,
            singular_values=np.concatenate((found.singular_values, np.full(max(missing, 0), np.nan))),
        )


class FreeRows(TaskRows):
    """Rows of a task for the free joints."""

    def __init__(self, rows: TaskRows, joints: FreeJoints, state: ArmState, ramp: Array) -> None:
        """Takes the rows of the last :meth:`TaskRows.place`.

        Args:
            rows: Those of all joints.
            joints: The free ones.
            state: State of the arm.
            ramp: Velocities of the locked joints, see :meth:`FreeJoints.ramp`.
        """
        self._rows, self._joints, self._q = rows, joints, state.q_middle
        self.row_scale, self.is_empty = rows.row_scale, rows.is_empty
        self.bands = None
        if rows.bands is not None:
            least = rows.bands.least - rows.bands.rows @ ramp
            bands = TaskBands(joints.columns(rows.bands.rows), least, rows.bands.names)
            self.bands = bands.of_joints_that_move()

    def place(self, q: Array) -> Array:
        """See :meth:`TaskRows.place`."""
        return self.jacobian(q)

    def jacobian(self, q: Array) -> Array:
        """See :meth:`TaskRows.jacobian`."""
        return self._joints.columns(self._rows.jacobian(self._joints.all_joints(q, self._q)))

    def twist(self, twist_b: Array) -> Array:
        """See :meth:`TaskRows.twist`."""
        return self._rows.twist(twist_b)

    def body_twist(self, twist: Array) -> Array:
        """See :meth:`TaskRows.body_twist`."""
        return self._rows.body_twist(twist)

    def wrench(self, multiplier: Array) -> Array:
        """See :meth:`TaskRows.wrench`."""
        return self._rows.wrench(multiplier)

    def all_singular_values(self, values: Array) -> Array:
        """See :meth:`TaskRows.all_singular_values`."""
        return self._rows.all_singular_values(values)

"""Rows of the task: J qd = s V for the whole pose, or the exact components and the bands of a tolerance.

With a tolerance, A are the rows of the exact components (:mod:`ik_node.math.task_error`) for body twists of the tool::

    J_t = A J_b ,   J_t qd = s (V_t - lost) ,   V_t = A V_b          followed exactly
    r_i J_b qd >= s v_i                                              bands, two rows each

A is evaluated at the joint positions of its Jacobian, with the target in the middle of the control interval. Everything
that the solver computes for J_t is given in {b} as well: a twist V_t as the least body twist V_b = A^+ V_t, and a
multiplier as the wrench A' lambda, which is zero along what is free. Without an exact component J_t is one row of
zeros.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math.quaternion import Vector
from ik_node.math.task_error import TaskForm, task_deviation
from ik_node.math.task_tolerance import COMPONENTS
from ik_node.math.types import Array
from ik_node.robot.robot import Robot


class TaskBands(NamedTuple):
    """The bands of one control step: ``rows`` qd >= s ``least``."""

    rows: Array
    """(k, n)."""
    least: Array
    """v, (k,), m/s or rad/s; negative inside a band, where the arm may still approach its border."""
    names: tuple[str, ...]
    """``band rx``, for every row."""

    def hold(self, velocity: Array, scale: float) -> bool:
        """True if ``velocity`` (n,) obeys all bands at the task scale s."""
        return bool((self.rows @ velocity >= scale * self.least - ROUNDING).all())

    def active(self, velocity: Array, scale: float) -> tuple[str, ...]:
        """Names of the bands that bind."""
        margins = self.rows @ velocity - scale * self.least
        return tuple(name for name, margin in zip(self.names, margins.tolist(), strict=True) if margin <= BINDING)


ROUNDING = 1e-12
"""By how much a velocity may exceed a band, m/s or rad/s."""
BINDING = 1e-9
"""Margin up to which a band binds, m/s or rad/s."""


class BandBorders(NamedTuple):
    """What the control law requires of the bands of a tolerance."""

    components: NDArray[np.intp]
    """Indices of the components that are bands, (b,)."""
    least: Array
    """v of each component at its positive border, then of each at its negative one, (2 b,)."""


class TaskRows:
    """The whole pose: J_t = J_b."""

    def __init__(self, robot: Robot, row_scale: Array) -> None:
        """``row_scale``: factors of the rows of J_b, (6,)."""
        self._robot = robot
        self.row_scale = row_scale
        """Factors of the rows of J_t, (m,)."""
        self.bands: TaskBands | None = None
        """Bands at the last :meth:`place`; None without any."""
        self.is_empty = False
        """True if no component is followed exactly."""

    def place(self, q: Array) -> Array:
        """J_t at the joint positions (n,) of the control step, (m, n)."""
        return self.jacobian(q)

    def jacobian(self, q: Array) -> Array:
        """J_t at joint positions (n,), (m, n)."""
        return self._robot.evaluate(q).jacobian_b

    def twist(self, twist_b: Array) -> Array:
        """V_t, (m,), of a body twist (6,)."""
        return twist_b

    def body_twist(self, twist: Array) -> Array:
        """The least body twist (6,) of V_t (m,)."""
        return twist

    def wrench(self, multiplier: Array) -> Array:
        """The wrench (6,) in {b} of a multiplier (m,)."""
        return multiplier

    def all_singular_values(self, values: Array) -> Array:
        """Singular values of J_t as a field of a Step: (min(6, n),), NaN for directions that do not count."""
        return values


class ToleranceRows(TaskRows):
    """The exact components and the bands of a tolerance, for one control step."""

    def __init__(
        self,
        robot: Robot,
        row_scale: Array,
        form: TaskForm,
        pose_sd: Array,
        swing_direction: Vector,
        borders: BandBorders,
    ) -> None:
        """Prepares the rows.

        Args:
            robot: The arm.
            row_scale: Factors of linear and angular rows, (6,).
            form: The tolerance.
            pose_sd: T_sd in the middle of the control interval, (4, 4).
            swing_direction: That of the feedback law.
            borders: Of the bands.
        """
        exact = np.flatnonzero(form.half_widths == 0.0)
        super().__init__(robot, row_scale[exact] if len(exact) else np.ones(1))
        self.is_empty = len(exact) == 0
        self._form, self._pose_sd, self._direction = form, np.ascontiguousarray(pose_sd), swing_direction
        self._exact, self._borders = exact, borders
        self._rows, self._lift = np.zeros((1, 6)), np.zeros((6, 1))

    def place(self, q: Array) -> Array:
        """See :meth:`TaskRows.place`; sets the rows that the other methods use."""
        pose, jacobian_b = self._robot.evaluate(q)[:2]
        rows_b, jacobian = _rows(self._form, pose, jacobian_b, self._pose_sd, self._direction)
        if not self.is_empty:
            self._rows = rows_b[self._exact]
            self._lift = least_twist_map(self._rows)
        components, least = self._borders
        if len(components):
            both = np.concatenate((jacobian[components], -jacobian[components]))
            moved = np.abs(both).max(axis=1) > ROUNDING  # an arm may be unable to move along a component
            names = 2 * tuple(f"band {COMPONENTS[index]}" for index in components.tolist())
            named = tuple(name for name, moves in zip(names, moved.tolist(), strict=True) if moves)
            self.bands = TaskBands(both[moved], least[moved], named)
        return self._exact_rows(jacobian)

    def jacobian(self, q: Array) -> Array:
        """See :meth:`TaskRows.jacobian`."""
        pose, jacobian_b = self._robot.evaluate(q)[:2]
        return self._exact_rows(_rows(self._form, pose, jacobian_b, self._pose_sd, self._direction)[1])

    def _exact_rows(self, jacobian: Array) -> Array:
        return np.zeros((1, self._robot.n)) if self.is_empty else jacobian[self._exact]

    def twist(self, twist_b: Array) -> Array:
        """See :meth:`TaskRows.twist`."""
        return np.asarray(self._rows @ twist_b)

    def body_twist(self, twist: Array) -> Array:
        """See :meth:`TaskRows.body_twist`."""
        return np.asarray(self._lift @ twist)

    def wrench(self, multiplier: Array) -> Array:
        """See :meth:`TaskRows.wrench`."""
        return np.asarray(multiplier @ self._rows)

    def all_singular_values(self, values: Array) -> Array:
        """See :meth:`TaskRows.all_singular_values`."""
        count = 0 if self.is_empty else len(values)
        return np.concatenate((values[:count], np.full(min(6, self._robot.n) - count, np.nan)))


@compiled
def _rows(
    form: TaskForm, pose_sb: Array, jacobian_b: Array, pose_sd: Array, swing_direction: Vector
) -> tuple[Array, Array]:
    """Rows of all six components for body twists (6, 6) and for joint velocities (6, n)."""
    rows_b = task_deviation(form, pose_sb, pose_sd, swing_direction).rows_b
    return rows_b, rows_b @ jacobian_b


@compiled
def least_twist_map(rows: Array) -> Array:
    """A^+ = A' (A A')^-1, (6, m), of rows A (m, 6) of full rank."""
    if len(rows) == 0:
        return np.zeros((6, 0))
    return np.ascontiguousarray(np.linalg.solve(rows @ rows.T, rows).T)

"""Rows of the task: J qd = s V for the whole pose, or the exact components and the bands of a tolerance.

With a tolerance, A are the rows of the exact components (:mod:`ik_node.math.task_error`) for body twists of the tool::

    J_t = A J_b ,   J_t qd = s (V_t - lost) ,   V_t = A V_b          followed exactly
    r_i J_b qd >= s v_i                                              bands, two rows each

A is evaluated at the joint positions of its Jacobian, with the target in the middle of the control interval. Everything
that the solver computes for J_t is given in {b} as well: a twist V_t as the least body twist V_b = A^+ V_t, and a
multiplier as the wrench A' lambda, which is zero along what is free. Without an exact component J_t is one row of
zeros.

A component c with the half-width w and the rate c' = f - r qd, where f is the feed-forward of the target, may approach
a border at the distance d = w - c or w + c at the rate vbar(d) of :func:`ik_node.robot.joint_limits.viable_speed_at`,
from which it still stops at the border: with holds of 1 / a, a the gain, it never exceeds a d, nor what the
acceleration b brakes. Beyond a border a component returns at a times its distance from it::

     r qd >=  f - vbar(w - c)         r qd >=  f + a (c - w)   beyond it
    -r qd >= -f - vbar(w + c)        -r qd >= -f + a (-c - w)  beyond it

b is what the joints can accelerate along a band while J_t qd keeps its rate. With A_q the diagonal matrix of the joint
accelerations, the joint acceleration of least size relative to them that accelerates r qd alone is::

    p = A_q^2 n' / (n A_q^2 n') ,   n = r - r A_q^2 J_t' (J_t A_q^2 J_t')^-1 J_t
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.motion import Motion
from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.quaternion import Vector
from ik_node.math.task_error import NO_DIRECTION, TaskForm, task_deviation
from ik_node.math.task_tolerance import COMPONENTS
from ik_node.math.types import Array
from ik_node.robot.joint_limits import viable_speed_at
from ik_node.robot.robot import Robot


class TaskBands(NamedTuple):
    """The bands of one control step: ``rows`` qd >= s ``least``."""

    rows: Array
    """(k, n)."""
    least: Array
    """v, (k,), m/s or rad/s; negative inside a band, where the arm may still approach its border."""
    names: tuple[str, ...]
    """``band rx``, for every row."""

    def of_joints_that_move(self) -> TaskBands:
        """Those along which the arm can move at all."""
        moved = np.abs(self.rows).max(axis=1) > ROUNDING
        names = tuple(name for name, moves in zip(self.names, moved.tolist(), strict=True) if moves)
        return TaskBands(self.rows[moved], self.least[moved], names)

    def active(self, velocity: Array, scale: float) -> tuple[str, ...]:
        """Names of the bands that bind."""
        margins = self.rows.dot(velocity) - scale * self.least  # faster than @
        return tuple(name for name, margin in zip(self.names, margins.tolist(), strict=True) if margin <= BINDING)


ROUNDING = 1e-12
"""By how much a velocity may exceed a band, m/s or rad/s."""
BINDING = 1e-9
"""Margin up to which a band binds, m/s or rad/s."""


LEAST_BORDER_RATE = 1.0
"""a is the gain, but at least this, 1/s: without feedback the arm may still use a band up to its border."""
BRAKING_FRACTION = 0.5
"""Fraction of the joint accelerations that braking before borders may use; the exact components and changes of the
target need the rest: with 0.8 random tasks of a Panda with 4 rad/s2 leave their bands by up to 20 mm."""
DAMPING = 1e-9
"""Relative damping of J_t A_q^2 J_t'."""


class BandBorders(NamedTuple):
    """What bounds the rates of the components that are bands."""

    components: NDArray[np.intp]
    """Indices of the components, (b,)."""
    gain: Array
    """a of each component, (b,), 1/s."""
    max_return: Array
    """Largest rate at which a component returns from beyond its band, (b,), m/s or rad/s."""
    acceleration: Array
    """Acceleration limits, (n,), rad/s2 (m/s2); 0 for locked joints."""


NO_BORDERS = BandBorders(np.zeros(0, dtype=np.intp), np.zeros(0), np.zeros(0), np.zeros(0))
"""Those of a task without bands."""


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
    """The exact components and the bands of a tolerance."""

    def __init__(self, robot: Robot, row_scale: Array, form: TaskForm, borders: BandBorders = NO_BORDERS) -> None:
        """Prepares the rows.

        Args:
            robot: The arm.
            row_scale: Factors of linear and angular rows, (6,).
            form: The tolerance.
            borders: Of its bands.
        """
        exact = np.flatnonzero(form.half_widths == 0.0)
        super().__init__(robot, row_scale[exact] if len(exact) else np.ones(1))
        self.is_empty = len(exact) == 0
        self._form, self._exact, self._borders = form, exact, borders
        self._names = 2 * tuple(f"band {COMPONENTS[index]}" for index in borders.components.tolist())
        self._missing = np.full(min(6, robot.n), np.nan)
        self._rows, self._lift = np.zeros((1, 6)), np.zeros((6, 1))
        self._pose_sd, self._twist_d, self._to_middle_s = np.eye(4), np.zeros(6), 0.0
        self._direction: Vector = NO_DIRECTION

    def aim(self, motion: Motion, to_middle_s: float = 0.0, swing_direction: Vector = NO_DIRECTION) -> None:
        """Sets the target of one control step.

        Args:
            motion: Desired motion.
            to_middle_s: Time from ``motion.pose_sd`` to the middle of the control interval, s.
            swing_direction: That of the feedback law.
        """
        self._pose_sd, self._twist_d = np.ascontiguousarray(motion.pose_sd), motion.twist_d
        self._to_middle_s, self._direction = to_middle_s, swing_direction

    def place(self, q: Array) -> Array:
        """See :meth:`TaskRows.place`; sets the rows that the other methods use."""
        pose, jacobian_b = self._robot.evaluate(q)[:2]
        jacobian, self._rows, self._lift, rows, least, move = _placed(
            self._form,
            self._exact,
            *self._borders,
            pose,
            jacobian_b,
            self._pose_sd,
            self._twist_d,
            self._to_middle_s,
            self._direction,
        )
        if self._names:
            bands = TaskBands(rows, least, self._names)
            self.bands = bands if move else bands.of_joints_that_move()
        return jacobian

    def jacobian(self, q: Array) -> Array:
        """See :meth:`TaskRows.jacobian`."""
        pose, jacobian_b = self._robot.evaluate(q)[:2]
        target = self._pose_sd, self._twist_d, self._to_middle_s, self._direction
        return np.asarray(_placed(self._form, self._exact, *NO_BORDERS, pose, jacobian_b, *target)[0])

    def twist(self, twist_b: Array) -> Array:
        """See :meth:`TaskRows.twist`."""
        found: Array = self._rows.dot(twist_b)
        return found

    def body_twist(self, twist: Array) -> Array:
        """See :meth:`TaskRows.body_twist`."""
        found: Array = self._lift.dot(twist)
        return found

    def wrench(self, multiplier: Array) -> Array:
        """See :meth:`TaskRows.wrench`."""
        found: Array = multiplier.dot(self._rows)
        return found

    def all_singular_values(self, values: Array) -> Array:
        """See :meth:`TaskRows.all_singular_values`."""
        found: Array = self._missing.copy()
        if not self.is_empty:
            found[: len(values)] = values
        return found


@compiled
def _placed(
    form: TaskForm,
    exact: NDArray[np.intp],
    components: NDArray[np.intp],
    gain: Array,
    max_return: Array,
    acceleration: Array,
    pose_sb: Array,
    jacobian_b: Array,
    pose_sd: Array,
    twist_d: Array,
    to_middle_s: float,
    swing_direction: Vector,
) -> tuple[Array, Array, Array, Array, Array, bool]:
    """J_t, A, A^+, rows and v of the bands, and whether the arm can move along all of them."""
    target = se3.compose(pose_sd, se3.exp6(to_middle_s * twist_d))
    deviation = task_deviation(form, pose_sb, target, swing_direction)
    jacobian, n = deviation.rows_b @ jacobian_b, jacobian_b.shape[1]
    m, count = max(len(exact), 1), len(components)
    rows, followed, lift = np.zeros((m, 6)), np.zeros((m, n)), np.zeros((6, m))
    for k in range(len(exact)):
        rows[k], followed[k] = deviation.rows_b[exact[k]], jacobian[exact[k]]
    if len(exact):
        lift = least_twist_map(rows)
    both, least, move = np.empty((2 * count, n)), np.empty(2 * count), True
    if count:
        for k in range(count):
            both[k], both[count + k] = jacobian[components[k]], -jacobian[components[k]]
            move = move and np.abs(both[k]).max() > ROUNDING
            least[k] = deviation.rows_d[components[k]] @ twist_d
        brake = braking_accelerations(followed, both[:count], least[:count], acceleration)
        for k in range(count):
            c, width, forward = deviation.components[components[k]], form.half_widths[components[k]], least[k]
            least[k] = forward - _border_rate(width - c, gain[k], max_return[k], brake[k])
            least[count + k] = -forward - _border_rate(width + c, gain[k], max_return[k], brake[k])
    return followed, rows, lift, both, least, move


@compiled
def _border_rate(inside: float, gain: float, max_return: float, acceleration: float) -> float:
    """Largest rate at which a component may approach a border at a distance; negative beyond the border."""
    if inside < 0.0:
        return max(gain * inside, -max_return)
    hold_s, slowest = 1.0 / max(gain, LEAST_BORDER_RATE), LEAST_BORDER_RATE * inside
    return max(viable_speed_at(inside, acceleration, hold_s, hold_s), slowest) if acceleration > 0.0 else slowest


@compiled
def braking_accelerations(jacobian: Array, rows: Array, rates: Array, acceleration: Array) -> Array:
    """What the joints can accelerate along each band for braking, (b,), m/s2 or rad/s2.

    The bands share each joint acceleration, in proportion to the times that their rates take to brake.

    Args:
        jacobian: J_t, (m, n), whose rate is kept.
        rows: Rows r of the bands, (b, n).
        rates: Of the target along the bands, (b,), m/s or rad/s.
        acceleration: Acceleration limits of the joints, (n,); 0 for those that cannot be used.
    """
    m, n = jacobian.shape
    count = len(rows)
    scaled, along = np.empty((m, n)), np.empty((count, n))
    for i in range(n):
        scaled[:, i], along[:, i] = acceleration[i] * jacobian[:, i], acceleration[i] * rows[:, i]
    gram = scaled @ scaled.T
    damping = DAMPING * np.trace(gram) + np.finfo(np.float64).tiny
    for i in range(m):
        gram[i, i] += damping
    along = along - np.ascontiguousarray(np.linalg.solve(gram, scaled @ along.T).T) @ scaled
    own, largest, braking_s, load = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(n)
    for k in range(count):
        largest[k] = np.abs(along[k]).max()
        if largest[k] > ROUNDING:
            own[k] = along[k] @ along[k] / largest[k]
            braking_s[k] = abs(rates[k]) / own[k]
    for k in range(count):
        if braking_s[k] > 0.0:
            load += braking_s[k] / braking_s.max() * np.abs(along[k]) / largest[k]
    return np.asarray(BRAKING_FRACTION * own / max(1.0, load.max()))


@compiled
def least_twist_map(rows: Array) -> Array:
    """A^+ = A' (A A')^-1, (6, m), of rows A (m, 6) of full rank."""
    if len(rows) == 0:
        return np.zeros((6, 0))
    return np.ascontiguousarray(np.linalg.solve(rows @ rows.T, rows).T)

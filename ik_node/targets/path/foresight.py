"""Foresight on a path: the greatest rate of its time at which the joints can follow the poses ahead.

Where the joints would have to turn faster than their limits permit (beside a singularity, at a corner) the bounds of
one control step act too late. The joint motion ahead is predicted from the twists of the path, dq/dz = p(z) with z the
time on the path, and the rate v = dz/dt and its square x require ::

    speed         |p_i| v                  <= vmax_i
    acceleration  |p'_i| x                 <= c a_i ,    |p_i dv/dt| <= a_i - |p'_i| x        p' = dp/dz

One pass from the end of the prediction, where the arm could stop, to its begin gives the greatest x <= 1 at each z, as
in :mod:`ik_node.targets.path.time_parametrisation`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.chain import PATH_DAMPING, damped_rates, moved_chain, relative_speeds
from ik_node.robot.joint_limits import MotionLimits, motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.jerk_limited_filter import mean_twist, pose_matrix
from ik_node.targets.path.timed_path import PathTable, resting_on

HORIZON_S = 1.0
"""Time on the path that is predicted."""
LONGEST_S, SHORTEST_S = 0.006, 2.5e-4
"""Longest and shortest interval of the prediction."""
MOTION = 0.012
"""Motion of the fastest joint in one interval, rad (m), within these lengths."""
MAX_POINTS, SPARE_POINTS = 600, 20
"""Largest number of points, at which the prediction ends, and how many are added at once after that."""
LIMIT_FRACTION = 0.8
"""Fraction of the joint limits that following the path may use; the rest is for feedback."""
BENDING_FRACTION = 0.7
"""c: fraction of the acceleration for the bending of the joint motion."""
MAX_ERROR = 1e-3
"""Largest distance of the predicted pose from the path at which the path counts as foreseen, m."""
CORRECTION_S = 0.05
"""Time constant with which the predicted pose returns to the path, s."""
DRIFT = 0.03
"""Largest difference of a measured joint position from the prediction, rad (m), before that begins anew."""
MIN_RATE = 1e-9
"""Joint rates below this, rad/s (m/s), count as zero."""
SLOWEST = 0.01
"""Smallest rate: a path that the prediction takes for impassable is followed within the limits of each step."""


class PathPrediction(NamedTuple):
    """Joint motion ahead on a path; plain data, never modified."""

    times_s: Array
    """z of the points, (k,), increasing."""
    positions: Array
    """Predicted joint positions, (k, n), rad (m)."""
    rates: Array
    """p from this point to the next one, (k, n); the last row has no meaning."""
    squares: Array
    """Greatest x at each point, (k,)."""
    changes: Array
    """Greatest dv/dt at each point, (k,), 1/s."""
    errors: Array
    """Distance of the predicted pose from the path at each point, with rotations times the length of D, (k,), m."""


class PathForesight:
    """Predicts the joint motion along paths; the prediction is kept by the caller."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        self._robot = robot
        self.configure(settings)

    def configure(self, settings: Settings) -> None:
        """Applies other settings."""
        self._limits = motion_limits(self._robot, settings.limits, settings.control.rate_hz)
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self._is_predictable = not any(settings.task.tolerance) and not settings.control.locked_joints

    def updated(
        self, known: PathPrediction | None, path: PathTable, end_s: float, time_s: float, q: Array
    ) -> PathPrediction | None:
        """The prediction from ``time_s`` on.

        Args:
            known: The prediction of the last control step; None for none.
            path: The path.
            end_s: Time of its end.
            time_s: Present time on the path.
            q: Measured joint positions, (n,), rad (m).

        Returns:
            None for an arm or a task that is not predicted, with locked joints, or at the end of the path.
        """
        if len(self._robot.chain_order) == 0 or not self._is_predictable or time_s >= end_s:
            return None
        if known is not None and not _is_valid(known, time_s, q, DRIFT):
            known = None
        until_s = min(time_s + HORIZON_S, end_s)
        if known is None:
            known = PathPrediction(
                np.array([time_s]), q[None, :].copy(), np.zeros((1, len(q))), np.zeros(1), np.zeros(1), np.zeros(1)
            )
        left = len(known.times_s) - int(np.searchsorted(known.times_s, time_s))
        if known.times_s[-1] >= until_s - SHORTEST_S or left >= MAX_POINTS - SPARE_POINTS:
            return known
        pose, jacobian = self._robot.evaluate(known.positions[-1])
        return _extended(
            known, path, time_s, until_s, end_s, pose, jacobian, self._robot.chain_order, self._row_scale, self._limits
        )


@compiled
def viable_rate(known: PathPrediction, time_s: float, hold_s: float, before: float) -> float:
    """The greatest rate of the next ``hold_s`` after the rate ``before``."""
    ahead_s = hold_s * max(before, SLOWEST)
    times_s, squares = known.times_s, known.squares
    first = max(int(np.searchsorted(times_s, time_s, side="right")) - 1, 0)
    least = min(_square_at(known, first, time_s), _square_at(known, first, time_s + ahead_s))
    for k in range(first + 1, len(times_s)):
        if times_s[k] > time_s + ahead_s:
            break
        least = min(least, squares[k])
    return float(max(min(np.sqrt(least), before + hold_s * known.changes[first]), SLOWEST))


@compiled
def is_foreseen(known: PathPrediction, time_s: float) -> bool:
    """True if the predicted pose at ``time_s`` is on the path: the joints can follow it as predicted."""
    first = max(int(np.searchsorted(known.times_s, time_s, side="right")) - 1, 0)
    return bool(known.errors[first] < MAX_ERROR)


@compiled
def _square_at(known: PathPrediction, first: int, time_s: float) -> float:
    times_s, squares, k = known.times_s, known.squares, first
    while k + 2 < len(times_s) and times_s[k + 1] <= time_s:
        k += 1
    if k + 1 >= len(times_s):
        return float(squares[k])
    u = min(max((time_s - times_s[k]) / (times_s[k + 1] - times_s[k]), 0.0), 1.0)
    return float((1.0 - u) * squares[k] + u * squares[k + 1])


@compiled
def _is_valid(known: PathPrediction, time_s: float, q: Array, drift: float) -> bool:
    """True if ``time_s`` is inside the prediction and q (n,) on it."""
    times_s = known.times_s
    if not times_s[0] <= time_s <= times_s[-1]:
        return False
    k = max(int(np.searchsorted(times_s, time_s, side="right")) - 1, 0)
    for i in range(len(q)):
        expected = known.positions[k, i] + (time_s - times_s[k]) * known.rates[k, i]
        if k + 1 >= len(times_s):
            expected = known.positions[k, i]
        if abs(q[i] - expected) > drift:
            return False
    return True


@compiled
def _extended(
    known: PathPrediction,
    path: PathTable,
    time_s: float,
    until_s: float,
    end_s: float,
    pose_sb: Array,
    jacobian: Array,
    order: NDArray[np.int64],
    row_scale: Array,
    limits: MotionLimits,
) -> PathPrediction:
    """The prediction without the points behind ``time_s``, extended to ``until_s``.

    Args:
        known: The prediction so far.
        path: The path.
        time_s: Present time on the path.
        until_s: Time until which the path is predicted.
        end_s: Its end.
        pose_sb: Pose of the tool at the last point, (4, 4).
        jacobian: Body Jacobian there, (6, n).
        order: Indices of the joints from the base to the tool, (n,).
        row_scale: D, (6,).
        limits: Limits of the joints.
    """
    n, speeds = jacobian.shape[1], relative_speeds(limits.velocity)
    first = max(int(np.searchsorted(known.times_s, time_s, side="right")) - 1, 0)
    count = len(known.times_s) - first
    times_s, positions = np.empty(MAX_POINTS), np.empty((MAX_POINTS, n))
    rates, errors = np.zeros((MAX_POINTS, n)), np.zeros(MAX_POINTS)
    times_s[:count], positions[:count], rates[:count], errors[:count] = (
        known.times_s[first:],
        known.positions[first:],
        known.rates[first:],
        known.errors[first:],
    )
    now_s = times_s[count - 1]
    q = positions[count - 1].copy()
    start, origin = resting_on(path, now_s), np.eye(4)
    while now_s < until_s - 1e-9 and count < MAX_POINTS:
        fastest = MIN_RATE
        if count > 1:
            for i in range(n):
                fastest = max(fastest, abs(rates[count - 2, i]))
        step_s = min(max(MOTION / fastest, SHORTEST_S), LONGEST_S)
        if until_s - now_s - step_s < SHORTEST_S:
            step_s = until_s - now_s
        end = resting_on(path, now_s + step_s)
        twist = mean_twist(start, end, step_s)
        error = se3.log6(se3.relative_pose(pose_sb, pose_matrix(start)))
        errors[count - 1] = np.sqrt(((row_scale * error) ** 2).sum())
        half = damped_rates(jacobian, twist, row_scale, PATH_DAMPING, speeds)
        middle, _ = moved_chain(jacobian, order, 0.5 * step_s * half)
        p = damped_rates(middle, twist, row_scale, PATH_DAMPING, speeds)
        to_path = damped_rates(jacobian, error, row_scale, 5.0 * PATH_DAMPING, speeds)
        change = step_s * p + min(1.0, step_s / CORRECTION_S) * to_path
        jacobian, back = moved_chain(jacobian, order, change)
        pose_sb = se3.compose(pose_sb, se3.relative_pose(back, origin))
        rates[count - 1] = p
        q = q + change
        now_s += step_s
        times_s[count], positions[count] = now_s, q
        errors[count] = errors[count - 1]
        start = end
        count += 1
    squares, changes = _greatest_squares(times_s[:count], rates[:count], limits, now_s >= end_s - 1e-9)
    return PathPrediction(
        times_s[:count].copy(), positions[:count].copy(), rates[:count].copy(), squares, changes, errors[:count].copy()
    )


@compiled
def _greatest_squares(times_s: Array, p: Array, limits: MotionLimits, ends: bool) -> tuple[Array, Array]:
    """The greatest x at each point, at most 1, from which the rest can be followed to rest at its end, and dv/dt."""
    count, n = p.shape
    x = np.zeros(count)
    ceiling, slowing = np.ones(count), np.full(count, 1e6)
    for k in range(count - 1):
        for i in range(n):
            rate = max(abs(p[k, i]), MIN_RATE)
            ceiling[k] = min(ceiling[k], (LIMIT_FRACTION * limits.velocity[i] / rate) ** 2)
    for k in range(1, count - 1):
        step_s = 0.5 * (times_s[k + 1] - times_s[k - 1])
        for i in range(n):
            bend = abs(p[k, i] - p[k - 1, i]) / step_s
            if bend > MIN_RATE:
                ceiling[k] = min(ceiling[k], BENDING_FRACTION * LIMIT_FRACTION * limits.acceleration[i] / bend)
    for k in range(1, count - 1):
        step_s = 0.5 * (times_s[k + 1] - times_s[k - 1])
        for i in range(n):
            bend = abs(p[k, i] - p[k - 1, i]) / step_s
            rate = max(abs(p[k, i]), abs(p[k - 1, i]), MIN_RATE)
            slowing[k] = min(slowing[k], (LIMIT_FRACTION * limits.acceleration[i] - bend * ceiling[k]) / rate)
    if count > 1:
        slowing[0] = slowing[1]
        slowing[count - 1] = slowing[count - 2]
    if ends:
        x[count - 1] = 1.0 if count < 2 else ceiling[count - 2]
    for k in range(count - 2, -1, -1):
        gain = 2.0 * (times_s[k + 1] - times_s[k]) * min(slowing[k], slowing[k + 1])
        x[k] = min(ceiling[k], x[k + 1] + gain)
    return x, slowing

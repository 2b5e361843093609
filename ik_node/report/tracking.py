"""How well the tool followed: errors against the truth at the same time, and how late it was."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.ground_truth import Poses, Truth, rotation_angle
from ik_node.robot.robot import Robot

LAG_RANGE_S = (-0.2, 0.6)
"""Lags looked for."""
LAG_STEP_S = 0.005
"""Grid on which the search begins."""
LAG_ROWS = 4000
"""Moments used in the search, evenly picked."""
LEAST_SPEED = 1e-3
"""Below this mean speed (m/s, rad/s) of the truth a lag cannot be told."""


class Errors(NamedTuple):
    """Root mean square and maximum; NaN over no moments at all."""

    position_rms_mm: float
    position_max_mm: float
    orientation_rms_mrad: float
    orientation_max_mrad: float


class Tracking(NamedTuple):
    """The measured tool pose against the truth at the joint state's own stamp."""

    against: str
    """What the truth is."""
    settle_s: float
    settled: Errors
    """From ``settle_s`` after the truth's start to its end."""
    overall: Errors
    """From the truth's start to its end."""
    lag_position_ms: float
    """The delay of the truth that makes the RMS position error least; NaN when the truth stands still."""
    lag_rotation_ms: float
    position_rms_without_lag_mm: float
    orientation_rms_without_lag_mrad: float


class Series(NamedTuple):
    """What a picture of the tracking needs, at every measured moment (m,)."""

    times_s: Array
    """On the axis of ``Run.times_s``."""
    measured: Poses
    wanted: Poses
    position_error: Array
    """m."""
    orientation_error: Array
    """rad."""
    inside: NDArray[np.bool_]
    """Between the truth's start and end."""


def measured_poses(run: Run) -> tuple[Poses, NDArray[np.int64], Array]:
    """Tool poses from the measured q alone, (m,), their ROS times and their times on the run's axis.

    Ticks without a joint state are left out, and so is a state that several ticks used.
    """
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, str(run.settings.get("joint_prefix", "")))
    rows = np.flatnonzero(np.isfinite(run.q).all(axis=1) & np.isfinite(run.state_times_s))
    _, first = np.unique(run.state_ros_ns[rows], return_index=True)
    rows = rows[first]
    position, quaternion = np.empty((len(rows), 3)), np.empty((len(rows), 4))
    for index, row in enumerate(rows.tolist()):
        pose = robot.pose(np.ascontiguousarray(run.q[row]))
        position[index], quaternion[index] = pose[:3, 3], se3.quaternion_from_rotation(pose[:3, :3])
    return Poses(position, quaternion), run.state_ros_ns[rows], run.state_times_s[rows]


def compare(run: Run, truth: Truth, settle_s: float) -> tuple[Tracking, Series]:
    """Errors and lag of ``run``, with the series behind them."""
    measured, ros_ns, times = measured_poses(run)
    wanted = truth.at(ros_ns)
    series = Series(
        times,
        measured,
        wanted,
        np.linalg.norm(measured.position - wanted.position, axis=1),
        rotation_angle(measured.quaternion, wanted.quaternion),
        (ros_ns >= truth.ros_ns[0]) & (ros_ns <= truth.ros_ns[-1]),
    )
    settled = series.inside & (ros_ns - truth.ros_ns[0] >= settle_s * NS)
    lag_position, lag_rotation = _lags(measured, ros_ns, truth, np.flatnonzero(settled))
    late = [truth.at(ros_ns[settled], 0.0 if math.isnan(lag) else lag) for lag in (lag_position, lag_rotation)]
    left_position = np.linalg.norm(measured.position[settled] - late[0].position, axis=1)
    left_rotation = rotation_angle(measured.quaternion[settled], late[1].quaternion)
    tracking = Tracking(
        against=truth.source,
        settle_s=settle_s,
        settled=_errors(series, settled),
        overall=_errors(series, series.inside),
        lag_position_ms=1e3 * lag_position,
        lag_rotation_ms=1e3 * lag_rotation,
        position_rms_without_lag_mm=1e3 * _rms(left_position),
        orientation_rms_without_lag_mrad=1e3 * _rms(left_rotation),
    )
    return tracking, series


def _errors(series: Series, rows: NDArray[np.bool_]) -> Errors:
    position, orientation = series.position_error[rows], series.orientation_error[rows]
    return Errors(1e3 * _rms(position), 1e3 * _max(position), 1e3 * _rms(orientation), 1e3 * _max(orientation))


def _lags(measured: Poses, ros_ns: NDArray[np.int64], truth: Truth, rows: NDArray[np.int64]) -> tuple[float, float]:
    """Lags in s of position and rotation; NaN where the truth does not move."""
    picked = rows[:: max(1, len(rows) // LAG_ROWS)]
    if len(picked) < 3:
        return math.nan, math.nan
    stamps, position, quaternion = ros_ns[picked], measured.position[picked], measured.quaternion[picked]

    def position_cost(lag_s: float) -> float:
        return _rms(np.linalg.norm(position - truth.at(stamps, lag_s).position, axis=1))

    def rotation_cost(lag_s: float) -> float:
        return _rms(rotation_angle(quaternion, truth.at(stamps, lag_s).quaternion))

    wanted, duration_s = truth.at(stamps), (stamps[-1] - stamps[0]) / NS
    path = np.linalg.norm(np.diff(wanted.position, axis=0), axis=1).sum()
    turn = rotation_angle(wanted.quaternion[1:], wanted.quaternion[:-1]).sum()
    return (
        _least(position_cost) if path > LEAST_SPEED * duration_s else math.nan,
        _least(rotation_cost) if turn > LEAST_SPEED * duration_s else math.nan,
    )


def _least(cost: Callable[[float], float]) -> float:
    """Where ``cost`` is least: the best of a grid, then golden sections between its neighbours."""
    grid: list[float] = np.arange(LAG_RANGE_S[0], LAG_RANGE_S[1] + 0.5 * LAG_STEP_S, LAG_STEP_S).tolist()
    best = float(min(grid, key=cost))
    low, high = best - LAG_STEP_S, best + LAG_STEP_S
    ratio = 0.5 * (math.sqrt(5.0) - 1.0)
    while high - low > 1e-6:
        inner_low, inner_high = high - ratio * (high - low), low + ratio * (high - low)
        if cost(inner_low) < cost(inner_high):
            high = inner_high
        else:
            low = inner_low
    return 0.5 * (low + high)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _max(values: Array) -> float:
    return float(values.max()) if len(values) else math.nan

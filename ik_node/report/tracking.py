"""Tracking errors of the tool against the ground truth at the same time, their two parts, and the lag.

The error *tool to trajectory* has two parts: *reference to trajectory*, what targets and smoothing did, and *tool to
reference*, what the control law and the limits did. The reference is the desired pose T_sd of the control steps. With
``task.tolerance`` an error is what exceeds the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.ground_truth import GroundTruth, Poses, rotation_angle
from ik_node.report.run_tasks import RunTask, TaskSeries, excess, run_tasks, task_series, task_text
from ik_node.robot.robot import Robot

LAG_RANGE_S = (-0.2, 0.6)
"""Range of the search for the lag."""
LAG_STEP_S = 0.005
"""Grid of the first search."""
LAG_ROWS = 4000
"""Number of samples used in the search, evenly spaced."""
MIN_MEAN_SPEED = 1e-3
"""Below this mean speed (m/s, rad/s) of the ground truth the lag cannot be estimated."""


class TrackingErrors(NamedTuple):
    """Root mean square and maximum; NaN without samples."""

    position_rms_mm: float
    position_max_mm: float
    orientation_rms_mrad: float
    orientation_max_mrad: float


class TrackingMetrics(NamedTuple):
    """Errors of the measured tool pose against the ground truth at the stamp of the joint state: tool to trajectory."""

    against: str
    """Name of the ground truth."""
    task: str
    """Tolerance that the errors count beyond; empty for whole poses."""
    settle_s: float
    settled: TrackingErrors
    """From ``settle_s`` after the start of the ground truth to its end."""
    overall: TrackingErrors
    """From the start of the ground truth to its end."""
    reference_to_trajectory: TrackingErrors
    """Part of the settled error: the desired pose T_sd against the ground truth."""
    tool_to_reference: TrackingErrors
    """Part of the settled error: the measured tool pose against T_sd."""
    lag_position_ms: float
    """Delay of the ground truth that minimises the RMS position error; NaN when the ground truth is at rest, and with a
    tolerance."""
    lag_rotation_ms: float
    position_rms_without_lag_mm: float
    orientation_rms_without_lag_mrad: float


class ErrorSeries(NamedTuple):
    """Distances of two series of poses; NaN where one of them is unknown."""

    position: Array
    """(m,), m."""
    orientation: Array
    """(m,), rad."""


class TrackingSeries(NamedTuple):
    """Poses and errors at every measured joint state, m rows."""

    times_s: Array
    """On the axis of ``Run.times_s``."""
    measured: Poses
    desired: Poses
    """Of the ground truth."""
    tool_to_trajectory: ErrorSeries
    reference_to_trajectory: ErrorSeries
    tool_to_reference: ErrorSeries
    inside: NDArray[np.bool_]
    """(m,), between start and end of the ground truth."""
    settled: NDArray[np.bool_]
    """(m,), from ``settle_s`` after the start of the ground truth to its end."""
    task: TaskSeries | None
    """The deviation in the axes of ``task.tolerance``; None if the whole pose is followed always."""


def measured_poses(run: Run) -> tuple[Poses, NDArray[np.int64], Array]:
    """Tool poses from the measured joint positions.

    Steps without a joint state are skipped; a joint state used by several steps is returned once.

    Returns:
        Poses in the base frame (m rows), their ROS times in ns (m,), and their times on the axis of ``run.times_s``.
    """
    rows = _measured_rows(run)
    return _tool_poses(run, rows), run.state_ros_ns[rows], run.state_times_s[rows]


def _measured_rows(run: Run) -> NDArray[np.int64]:
    rows = np.flatnonzero(np.isfinite(run.q).all(axis=1) & np.isfinite(run.state_times_s))
    _, first = np.unique(run.state_ros_ns[rows], return_index=True)
    return np.asarray(rows[first])


def _tool_poses(run: Run, rows: NDArray[np.int64]) -> Poses:
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, str(run.settings.get("joint_prefix", "")))
    return _poses([robot.pose(np.ascontiguousarray(run.q[row])) for row in rows.tolist()])


def _poses(matrices: Iterable[Array]) -> Poses:
    """Poses of homogeneous matrices; those that are not finite become NaN."""
    position, quaternion = [], []
    for matrix in matrices:
        known = bool(np.isfinite(matrix).all())
        position.append(matrix[:3, 3] if known else np.full(3, np.nan))
        quaternion.append(se3.quaternion_from_rotation(matrix[:3, :3]) if known else np.full(4, np.nan))
    return Poses(np.array(position).reshape(-1, 3), np.array(quaternion).reshape(-1, 4))


def _distances(tool: Poses, target: Poses, tasks: Sequence[RunTask]) -> ErrorSeries:
    """Errors of m poses; ``tasks``: the tolerance of each row."""
    position = np.linalg.norm(tool.position - target.position, axis=1)
    orientation = rotation_angle(tool.quaternion, target.quaternion)
    for tolerance, rows in tasks:
        if not tolerance.is_exact:
            for row in np.flatnonzero(rows & np.isfinite(position)).tolist():
                position[row], orientation[row] = excess(tolerance, _matrix(tool, row), _matrix(target, row))
    return ErrorSeries(position, orientation)


def _matrices(poses: Poses) -> Array:
    return np.array([_matrix(poses, row) for row in range(len(poses.position))]).reshape(-1, 4, 4)


def _matrix(poses: Poses, row: int) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = se3.rotation_from_quaternion(poses.quaternion[row])
    pose[:3, 3] = poses.position[row]
    return pose


def tool_to_reference(run: Run) -> TrackingErrors:
    """The measured tool pose against the desired pose T_sd, over all control steps that have one."""
    error = run.error_b[np.isfinite(run.error_b).all(axis=1)]
    return _errors(ErrorSeries(np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)))


def compare(run: Run, truth: GroundTruth, settle_s: float) -> tuple[TrackingMetrics, TrackingSeries]:
    """Errors and lag of ``run``, with the poses and errors over time."""
    rows = _measured_rows(run)
    measured, ros_ns, times = _tool_poses(run, rows), run.state_ros_ns[rows], run.state_times_s[rows]
    desired, reference = truth.at(ros_ns), _poses(run.pose_sd[rows])
    tasks = [task._replace(rows=task.rows[rows]) for task in run_tasks(run)]
    series = TrackingSeries(
        times,
        measured,
        desired,
        tool_to_trajectory=_distances(measured, desired, tasks),
        reference_to_trajectory=_distances(reference, desired, tasks),
        tool_to_reference=_distances(measured, reference, tasks),
        inside=(ros_ns >= truth.ros_ns[0]) & (ros_ns <= truth.ros_ns[-1]),
        settled=(ros_ns - truth.ros_ns[0] >= settle_s * NS) & (ros_ns <= truth.ros_ns[-1]),
        task=task_series(tasks, _matrices(measured), _matrices(desired)),
    )
    settled = series.settled
    lag_position = lag_rotation = math.nan
    remaining = ErrorSeries(series.tool_to_trajectory.position[settled], series.tool_to_trajectory.orientation[settled])
    if not task_text(tasks):
        lag_position, lag_rotation = _lags(measured, ros_ns, truth, np.flatnonzero(settled))
        delayed = [truth.at(ros_ns[settled], 0.0 if math.isnan(lag) else lag) for lag in (lag_position, lag_rotation)]
        remaining = ErrorSeries(
            np.linalg.norm(measured.position[settled] - delayed[0].position, axis=1),
            rotation_angle(measured.quaternion[settled], delayed[1].quaternion),
        )
    tracking = TrackingMetrics(
        against=truth.source,
        task=task_text(tasks),
        settle_s=settle_s,
        settled=_errors(series.tool_to_trajectory, settled),
        overall=_errors(series.tool_to_trajectory, series.inside),
        reference_to_trajectory=_errors(series.reference_to_trajectory, settled),
        tool_to_reference=_errors(series.tool_to_reference, settled),
        lag_position_ms=1e3 * lag_position,
        lag_rotation_ms=1e3 * lag_rotation,
        position_rms_without_lag_mm=1e3 * _rms(remaining.position),
        orientation_rms_without_lag_mrad=1e3 * _rms(remaining.orientation),
    )
    return tracking, series


def _errors(series: ErrorSeries, rows: NDArray[np.bool_] | None = None) -> TrackingErrors:
    counts = np.isfinite(series.position) if rows is None else rows & np.isfinite(series.position)
    position, orientation = series.position[counts], series.orientation[counts]
    return TrackingErrors(1e3 * _rms(position), 1e3 * _max(position), 1e3 * _rms(orientation), 1e3 * _max(orientation))


def _lags(
    measured: Poses, ros_ns: NDArray[np.int64], truth: GroundTruth, rows: NDArray[np.int64]
) -> tuple[float, float]:
    """Lags of position and orientation in s; NaN where the ground truth is at rest."""
    picked = rows[:: max(1, len(rows) // LAG_ROWS)]
    if len(picked) < 3:
        return math.nan, math.nan
    stamps, position, quaternion = ros_ns[picked], measured.position[picked], measured.quaternion[picked]

    def position_cost(lag_s: float) -> float:
        return _rms(np.linalg.norm(position - truth.at(stamps, lag_s).position, axis=1))

    def rotation_cost(lag_s: float) -> float:
        return _rms(rotation_angle(quaternion, truth.at(stamps, lag_s).quaternion))

    desired, duration_s = truth.at(stamps), (stamps[-1] - stamps[0]) / NS
    path = np.linalg.norm(np.diff(desired.position, axis=0), axis=1).sum()
    turn = rotation_angle(desired.quaternion[1:], desired.quaternion[:-1]).sum()
    return (
        _minimise(position_cost) if path > MIN_MEAN_SPEED * duration_s else math.nan,
        _minimise(rotation_cost) if turn > MIN_MEAN_SPEED * duration_s else math.nan,
    )


def _minimise(cost: Callable[[float], float]) -> float:
    """Argument of the minimum: the best point of a grid, refined by golden-section search between its neighbours."""
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

"""Motion in the null space of the task: the part of the joint velocity that moves no followed component of the tool."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.run_tasks import run_tasks
from ik_node.robot.robot import Robot

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest are zero: their directions belong to the null space."""


class NullSpaceMetrics(NamedTuple):
    """Norm of N qd over a run, rad/s (m/s); NaN without a control step in closed loop."""

    rms: float
    max: float


class NullSpaceSeries(NamedTuple):
    """Motion in the null space over time."""

    times_s: Array
    """(k,), on the axis of ``Run.times_s``."""
    speed: Array
    """Norm of N qd, (k,), rad/s (m/s); NaN without a measured position."""


def null_space_motion(run: Run, robot: Robot) -> tuple[NullSpaceMetrics, NullSpaceSeries]:
    """Motion of a run in the null space of its task.

    N = I - J^+ J projects orthogonally, so that N qd = 0 for ``plain`` without active limits, and the other methods
    show what they add. J are the rows of J_b that the task follows exactly, at the measured position; commands are
    computed for the middle of their interval, so that ``plain`` has some 1e-4 rad/s here.

    Args:
        run: The recorded run.
        robot: Its robot.
    """
    known = np.asarray(np.isfinite(run.q).all(axis=1) & np.isfinite(run.joint_velocity).all(axis=1))
    speed = np.full(len(known), np.nan)
    for tolerance, active in run_tasks(run):
        has_rows = tolerance.is_exact | np.isfinite(run.pose_sd).all(axis=(1, 2))
        rows = np.flatnonzero(known & active & has_rows)
        if len(rows):
            jacobians = np.array([_followed_rows(run, robot, tolerance, row) for row in rows.tolist()])
            speed[rows] = null_space_speed(jacobians, run.joint_velocity[rows])
    finite = speed[np.isfinite(speed)]
    metrics = NullSpaceMetrics(math.nan, math.nan)
    if len(finite):
        metrics = NullSpaceMetrics(float(np.sqrt(np.mean(finite**2))), float(finite.max()))
    return metrics, NullSpaceSeries(run.times_s, speed)


def null_space_speed(jacobians: Array, velocities: Array) -> Array:
    """Norm of N qd.

    Args:
        jacobians: Followed rows of J_b, (k, m, n).
        velocities: qd, (k, n), rad/s (m/s).

    Returns:
        (k,), rad/s (m/s).
    """
    _, sigma, directions = np.linalg.svd(jacobians, full_matrices=False)
    moves = sigma > RANK_TOLERANCE * sigma[:, :1]
    along = np.einsum("kmn,kn->km", directions, velocities) * moves
    remaining = velocities - np.einsum("kmn,km->kn", directions, along)
    result: Array = np.linalg.norm(remaining, axis=1)
    return result


def _followed_rows(run: Run, robot: Robot, tolerance: TaskTolerance, row: int) -> Array:
    jacobian_b = robot.evaluate(run.q[row]).jacobian_b
    if tolerance.is_exact:
        return jacobian_b
    pose_sb, pose_sd = (np.ascontiguousarray(pose[row]) for pose in (run.pose_sb, run.pose_sd))
    return np.asarray(task_deviation(tolerance.form, pose_sb, pose_sd).rows_b[tolerance.exact] @ jacobian_b)

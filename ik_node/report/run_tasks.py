"""The tolerances of a run over time, the deviation in their axes, and its part that exceeds them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.clearances import settings_of

TASK_PARAMETERS = ("task.tolerance", "task.frame")


class RunTask(NamedTuple):
    """A tolerance and the control steps that it applies to."""

    tolerance: TaskTolerance
    rows: NDArray[np.bool_]
    """(k,)"""


def run_tasks(run: Run) -> tuple[RunTask, ...]:
    """The tolerances of a run in the order of time; every control step has one."""
    settings = settings_of(run)
    found = [(-math.inf, settings.task)]
    for time_s, changed in run.setting_changes:
        values = {name: value for name, value in changed.items() if name in TASK_PARAMETERS}
        if values:
            settings = settings.with_values(values)
            found.append((time_s, settings.task))
    ends = [*(time_s for time_s, _ in found[1:]), math.inf]
    return tuple(
        RunTask(TaskTolerance(task.tolerance, task.frame), np.asarray((run.times_s > begin) & (run.times_s <= end)))
        for (begin, task), end in zip(found, ends, strict=True)
    )


class TaskSeries(NamedTuple):
    """Deviation of the tool from the trajectory in the axes of the tolerance; NaN while the whole pose is followed."""

    components: Array
    """(m, 6), from the tool to the trajectory, m and rad; also of free components."""
    half_widths: Array
    """(m, 6), m and rad; infinite for free components."""


def task_series(tasks: Sequence[RunTask], pose_sb: Array, pose_sd: Array) -> TaskSeries | None:
    """The deviation of m poses in the axes of the tolerance of each.

    Args:
        tasks: Tolerances; each has the rows of the poses that it applies to, (m,).
        pose_sb: Poses of the tool, (m, 4, 4).
        pose_sd: Poses of the trajectory, (m, 4, 4); a pose that is not known is NaN.

    Returns:
        The components and their half-widths; None if the whole pose is followed always.
    """
    if not task_text(tasks):
        return None
    series = TaskSeries(np.full((len(pose_sb), 6), np.nan), np.full((len(pose_sb), 6), np.nan))
    for tolerance, rows in tasks:
        if not tolerance.is_exact:
            series.half_widths[rows] = tolerance.half_widths
            for row in np.flatnonzero(rows & np.isfinite(pose_sb + pose_sd).all(axis=(1, 2))).tolist():
                series.components[row] = task_deviation(tolerance.form, pose_sb[row], pose_sd[row]).components
    return series


def task_text(tasks: Sequence[RunTask]) -> str:
    """The tolerances that are not exact, in one line; empty for whole poses."""
    texts = [f"tolerance {task.tolerance.text()} in the frame {task.tolerance.frame}" for task in tasks
             if not task.tolerance.is_exact and task.rows.any()]  # fmt: skip
    return ", then ".join(dict.fromkeys(texts))


def excess(tolerance: TaskTolerance, pose_sb: Array, pose_sd: Array) -> tuple[float, float]:
    """Lengths of the linear and of the angular part of a deviation that exceed a tolerance.

    Args:
        tolerance: The task.
        pose_sb: Pose of the tool, (4, 4).
        pose_sd: Pose of the target, (4, 4).

    Returns:
        m and rad; 0 where the task is fulfilled.
    """
    components = task_deviation(tolerance.form, np.ascontiguousarray(pose_sb), np.ascontiguousarray(pose_sd)).components
    beyond = np.maximum(np.abs(components) - np.array(tolerance.half_widths), 0.0)
    return float(np.linalg.norm(beyond[:3])), float(np.linalg.norm(beyond[3:]))

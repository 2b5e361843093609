"""The tolerances of a run over time, and the part of a deviation that exceeds them."""

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

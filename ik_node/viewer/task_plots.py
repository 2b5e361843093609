"""The parts of a task that are not exact: their deviation from the desired pose, for plots and texts of the viewer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ik_node.math.task_error import task_deviation
from ik_node.math.task_tolerance import COMPONENTS, TaskTolerance
from ik_node.math.types import Array
from ik_node.viewer.plots import HEIGHT_PX, LEGEND_PX, PlotSpec
from ik_node.viewer.timeline import Timeline

POSITIONS, ROTATIONS = "Free and band positions [mm]", "Free and band rotations [mrad]"


def loose_deviation(tolerance: TaskTolerance, pose_sb: Array, pose_sd: Array) -> Array:
    """Deviation of the tool from the desired pose, (6,), mm and mrad; NaN where the task is exact or not known."""
    if tolerance.is_exact or not np.isfinite(pose_sb + pose_sd).all():
        return np.full(6, np.nan)
    poses = np.ascontiguousarray(pose_sb), np.ascontiguousarray(pose_sd)
    return np.where(tolerance.exact, np.nan, 1e3 * task_deviation(tolerance.form, *poses).components)


def loose_texts(tolerance: TaskTolerance, pose_sb: Array, pose_sd: Array) -> list[tuple[str, str]]:
    """Name and text of each component that is not exact, such as ``rz, free`` and ``12.0 mrad``."""
    rows = []
    values = loose_deviation(tolerance, pose_sb, pose_sd).tolist()
    for index in np.flatnonzero(~tolerance.exact).tolist():
        width, unit = 1e3 * tolerance.half_widths[index], "mm" if index < 3 else "mrad"
        kind = "free" if np.isinf(width) else f"band of ±{width:g} {unit}"
        rows.append((f"{COMPONENTS[index]}, {kind}", f"{values[index]:.1f} {unit}"))
    return rows


def task_plots(tolerance_at: Callable[[float], TaskTolerance]) -> tuple[PlotSpec, PlotSpec]:
    """Plots of the positions and the rotations that are not exact at their time; empty while all of them are.

    Args:
        tolerance_at: Time in s -> the tolerance of the task.
    """
    known: dict[float, Sequence[float]] = {}

    def components(timeline: Timeline) -> Array:
        if len(known) > 4 * len(timeline.times_s):
            known.clear()
        for row, time_s in enumerate(timeline.times_s.tolist()):
            if time_s not in known:
                deviation = loose_deviation(tolerance_at(time_s), timeline.pose_sb[row], timeline.pose_sd[row])
                known[time_s] = deviation.tolist()
        return np.array([known[time_s] for time_s in timeline.times_s.tolist()]).reshape(-1, 6)

    height = HEIGHT_PX + LEGEND_PX
    return (
        PlotSpec(POSITIONS, COMPONENTS[:3], lambda timeline: components(timeline)[:, :3], None, height, True),
        PlotSpec(ROTATIONS, COMPONENTS[3:], lambda timeline: components(timeline)[:, 3:], None, height, True),
    )

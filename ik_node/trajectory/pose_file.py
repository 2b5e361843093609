"""Loads recorded poses from CSV, text and NPY files as trajectories."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ik_node.errors import InputError, TrajectoryFileError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory import pose_columns
from ik_node.trajectory.pose_columns import PoseColumns
from ik_node.trajectory.pose_file_format import (
    DEFAULT_DURATION_S,
    LENGTH_UNITS,
    MAX_DURATION_S,
    NO_COLUMN,
    ORDERS,
    TIME_UNITS,
    PoseFileFormat,
)
from ik_node.trajectory.pose_table import PoseTable, read_table
from ik_node.trajectory.sampled import SampledTrajectory

LARGEST_POSITION_M = 3.0
"""Largest plausible position in metres if the file does not state a unit."""


class PoseFileTrajectory(SampledTrajectory):
    """The trajectory of a file, interpolated by :class:`SampledTrajectory`."""

    def __init__(self, times_s: Array, poses: Array, description: str) -> None:
        super().__init__(times_s, poses)
        self._description = description

    def describe(self) -> str:
        """One line with the columns, units and times that were read."""
        return self._description


def load(
    path: str | Path, file_format: PoseFileFormat | None = None, start_pose: Array | None = None
) -> PoseFileTrajectory:
    """Loads a trajectory from a file.

    Args:
        path: CSV, text or NPY file.
        file_format: Format of the file; default: detected.
        start_pose: Start pose T_sb of the arm (4, 4), for ``relative`` and for parts that the file does not have.

    Returns:
        The trajectory.

    Raises:
        TrajectoryFileError: The file does not have the format, its unit of length or order of the quaternion is
            ambiguous, times decrease, or a number is not finite. The message states the column or sample.
    """
    file, file_format = Path(path), file_format or PoseFileFormat()
    table = read_table(file, file_format.demo)
    if len(table) < 2:
        raise TrajectoryFileError(f"{file.name} holds {len(table)} sample; a motion needs two")
    columns = _columns(table, file_format)
    start = None if start_pose is None else se3.checked_pose(start_pose, "start_pose")
    times, timing = _times(table, columns, file_format)
    poses = _poses(table, columns, file_format, start)
    used = _window(times, file_format, file.name)
    times, poses = times[used] - times[used][0], poses[used]
    _place(poses, file_format, start, file.name)
    try:
        return PoseFileTrajectory(
            times, poses, _description(table, columns, file_format, timing, float(times[-1]), len(times))
        )
    except InputError as error:
        raise TrajectoryFileError(f"{file.name}: {error}") from error


def _columns(table: PoseTable, file_format: PoseFileFormat) -> PoseColumns:
    """Explicit columns if given, detected ones otherwise."""
    if file_format.position:
        quaternion, order = pose_columns.quaternion_beside(table, file_format.position)
        time, unit = pose_columns.named_time(table)
        found = PoseColumns(file_format.position, quaternion, order, time, unit)
    else:
        found = pose_columns.detect(table, file_format.prefix)
    if file_format.quaternion:
        given = () if file_format.quaternion == (NO_COLUMN,) else file_format.quaternion
        order = "".join(name[-1].lower() for name in given if not name.isdecimal())
        found = found._replace(quaternion=given, order=order if order in ORDERS else "")
    if file_format.order and (file_format.quaternion or not found.order):
        found = found._replace(order=file_format.order)
    if file_format.time or file_format.time_file:
        found = found._replace(time="" if file_format.time == NO_COLUMN else file_format.time, time_unit="")
    if found.quaternion and not found.order:
        raise TrajectoryFileError(
            f"{table.path.name}: the order of the quaternion in columns {', '.join(found.quaternion)} is not known; "
            f"say which: {' or '.join(ORDERS)}"
        )
    return found


def _times(table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat) -> tuple[Array, str]:
    """Times from the first sample (N,) [s], and a description of their origin."""
    if columns.time or file_format.time_file:
        times, said = _stamps(table, columns, file_format)
        if file_format.duration_s is not None:
            times *= file_format.duration_s / times[-1]
            said += f", played in {file_format.duration_s:g} s"
        return times, said
    duration_s = DEFAULT_DURATION_S if file_format.duration_s is None else file_format.duration_s
    origin = "no time in the file" if file_format.duration_s is None else "as asked"
    return np.linspace(0.0, duration_s, len(table)), f"evenly spaced over {duration_s:g} s ({origin})"


def _stamps(table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat) -> tuple[Array, str]:
    source = read_table(Path(file_format.time_file)) if file_format.time_file else table
    if len(source) != len(table):
        raise TrajectoryFileError(
            f"{source.path.name} holds {len(source)} samples, {table.path.name} holds {len(table)}; expected as many"
        )
    column = columns.time or pose_columns.named_time(source)[0] or source.names[0]
    unit = file_format.time_unit or pose_columns.time_unit(column) or "s"
    stamps = source.column(column)
    times = (stamps - stamps[0]) * TIME_UNITS[unit]
    backwards = np.flatnonzero(np.diff(times) < 0.0)
    if backwards.size:
        row = int(backwards[0]) + 1
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' goes backwards at sample {row}, "
            f"from {stamps[row - 1]:.12g} to {stamps[row]:.12g}"
        )
    if not 0.0 < times[-1] <= MAX_DURATION_S:
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' spans {times[-1]:g} s when it is in {unit}; "
            f"say its unit: {', '.join(TIME_UNITS)}"
        )
    where = f" of {source.path.name}" if file_format.time_file else ""
    return times, f"time '{column}'{where} [{unit}]"


def _poses(table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat, start: Array | None) -> Array:
    """Poses (N, 4, 4) in metres; missing parts are those of the start pose."""
    count = len(table)
    missing = [
        name
        for name, is_there in (("z", len(columns.position) == 3), ("orientation", columns.quaternion))
        if not is_there
    ]
    if missing and start is None:
        raise TrajectoryFileError(f"{table.path.name} holds no {' and no '.join(missing)}, and no start pose was given")
    poses = np.tile(np.eye(4) if start is None else start, (count, 1, 1))
    position = np.column_stack([table.column(name) for name in columns.position])
    largest = float(np.abs(position).max())
    if not file_format.units and largest > LARGEST_POSITION_M:
        raise TrajectoryFileError(
            f"{table.path.name}: positions reach {largest:g}, further than an arm in metres; "
            f"say the unit of length: {', '.join(LENGTH_UNITS)}"
        )
    poses[:, : position.shape[1], 3] = position * LENGTH_UNITS[file_format.units or "m"]
    if columns.quaternion:
        quaternions = np.column_stack([table.column(name) for name in columns.quaternion])
        if columns.order == "wxyz":
            quaternions = np.roll(quaternions, -1, axis=1)
        for index, quaternion in enumerate(quaternions):
            try:
                poses[index, :3, :3] = se3.rotation_from_quaternion(quaternion)
            except InputError as error:
                raise TrajectoryFileError(f"{table.path.name}: sample {index}: {error}") from error
    return poses


def _window(times: Array, file_format: PoseFileFormat, name: str) -> slice:
    end_s = float(times[-1]) if file_format.end_s is None else file_format.end_s
    first, last = int(np.searchsorted(times, file_format.start_s)), int(np.searchsorted(times, end_s, side="right"))
    if last - first < 2 or times[first] == times[last - 1]:
        raise TrajectoryFileError(
            f"{name}: no motion between start_s {file_format.start_s:g} and end_s {end_s:g}; it lasts {times[-1]:.4g} s"
        )
    return slice(first, last)


def _place(poses: Array, file_format: PoseFileFormat, start: Array | None, name: str) -> None:
    """Scales the poses, moves them onto the start pose and by the offset, in place."""
    first = poses[0].copy()
    poses[:, :3, 3] = first[:3, 3] + file_format.scale * (poses[:, :3, 3] - first[:3, 3])
    if file_format.relative:
        if start is None:
            raise TrajectoryFileError(f"{name}: relative needs the arm's start pose")
        poses[:, :3, 3] += start[:3, 3] - first[:3, 3]
        poses[:, :3, :3] = poses[:, :3, :3] @ (first[:3, :3].T @ start[:3, :3])
    poses[:, :3, 3] += file_format.offset


def _description(
    table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat, timing: str, duration_s: float, count: int
) -> str:
    parts = [f"{count} samples over {duration_s:.4g} s", timing]
    parts.append(f"position {', '.join(columns.position)} [{file_format.units or 'm'}]")
    parts.append(
        f"quaternion {', '.join(columns.quaternion)} [{columns.order}]" if columns.quaternion else "orientation held"
    )
    if len(columns.position) == 2:
        parts.append("z held")
    if file_format.relative:
        parts.append("relative to the start pose")
    if table.note:
        parts.insert(0, table.note)
    return f"{table.path.name}: " + "; ".join(parts)

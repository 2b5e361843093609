"""Recorded poses as trajectories: CSV, text and NPY files of other people, as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ik_node.errors import InputError, TrajectoryFileError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.trajectory import pose_columns
from ik_node.trajectory.pose_columns import Columns
from ik_node.trajectory.pose_file_format import (
    DEFAULT_DURATION_S,
    LENGTH_UNITS,
    LONGEST_S,
    NO_COLUMN,
    ORDERS,
    TIME_UNITS,
    PoseFileFormat,
)
from ik_node.trajectory.pose_table import Table, read_table
from ik_node.trajectory.sampled import SampledTrajectory

LARGEST_POSITION_M = 3.0
"""Without a stated unit, positions beyond this are not believed to be metres."""


class PoseFileTrajectory(SampledTrajectory):
    """The motion that a file holds; interpolated as :class:`SampledTrajectory` says."""

    def __init__(self, times_s: Array, poses: Array, description: str) -> None:
        super().__init__(times_s, poses)
        self._description = description

    def describe(self) -> str:
        """One line: what was read and how it was understood."""
        return self._description


def load(path: str | Path, how: PoseFileFormat | None = None, start_pose: Array | None = None) -> PoseFileTrajectory:
    """Reads the motion in ``path``.

    ``start_pose`` (4, 4) is the arm's at the start: needed for ``relative`` and for what the file does not hold.
    Raises TrajectoryFileError, naming the column or sample, when the file does not hold what ``how`` says, when its
    unit of length or order of quaternion cannot be told, when stamps go backwards, or when a number is not finite.
    """
    file, how = Path(path), how or PoseFileFormat()
    table = read_table(file, how.demo)
    if len(table) < 2:
        raise TrajectoryFileError(f"{file.name} holds {len(table)} sample; a motion needs two")
    columns = _columns(table, how)
    start = None if start_pose is None else se3.checked_pose(start_pose, "start_pose")
    times, timing = _times(table, columns, how)
    poses = _poses(table, columns, how, start)
    used = _window(times, how, file.name)
    times, poses = times[used] - times[used][0], poses[used]
    _place(poses, how, start, file.name)
    try:
        return PoseFileTrajectory(times, poses, _description(table, columns, how, timing, float(times[-1]), len(times)))
    except InputError as error:
        raise TrajectoryFileError(f"{file.name}: {error}") from error


def _columns(table: Table, how: PoseFileFormat) -> Columns:
    """Explicit columns where given, found ones elsewhere."""
    if how.position:
        quaternion, order = pose_columns.quaternion_beside(table, how.position)
        time, unit = pose_columns.named_time(table)
        found = Columns(how.position, quaternion, order, time, unit)
    else:
        found = pose_columns.detect(table, how.prefix)
    if how.quaternion:
        given = () if how.quaternion == (NO_COLUMN,) else how.quaternion
        order = "".join(name[-1].lower() for name in given if not name.isdecimal())
        found = found._replace(quaternion=given, order=order if order in ORDERS else "")
    if how.order and (how.quaternion or not found.order):
        found = found._replace(order=how.order)
    if how.time or how.time_file:
        found = found._replace(time="" if how.time == NO_COLUMN else how.time, time_unit="")
    if found.quaternion and not found.order:
        raise TrajectoryFileError(
            f"{table.path.name}: the order of the quaternion in columns {', '.join(found.quaternion)} is not known; "
            f"say which: {' or '.join(ORDERS)}"
        )
    return found


def _times(table: Table, columns: Columns, how: PoseFileFormat) -> tuple[Array, str]:
    """Seconds from the first sample (N,), and how they were found."""
    if columns.time or how.time_file:
        times, said = _stamps(table, columns, how)
        if how.duration_s is not None:
            times *= how.duration_s / times[-1]
            said += f", played in {how.duration_s:g} s"
        return times, said
    duration_s = DEFAULT_DURATION_S if how.duration_s is None else how.duration_s
    origin = "no time in the file" if how.duration_s is None else "as asked"
    return np.linspace(0.0, duration_s, len(table)), f"evenly spaced over {duration_s:g} s ({origin})"


def _stamps(table: Table, columns: Columns, how: PoseFileFormat) -> tuple[Array, str]:
    source = read_table(Path(how.time_file)) if how.time_file else table
    if len(source) != len(table):
        raise TrajectoryFileError(
            f"{source.path.name} holds {len(source)} samples, {table.path.name} holds {len(table)}; expected as many"
        )
    column = columns.time or pose_columns.named_time(source)[0] or source.names[0]
    unit = how.time_unit or pose_columns.time_unit(column) or "s"
    stamps = source.column(column)
    times = (stamps - stamps[0]) * TIME_UNITS[unit]
    backwards = np.flatnonzero(np.diff(times) < 0.0)
    if backwards.size:
        row = int(backwards[0]) + 1
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' goes backwards at sample {row}, "
            f"from {stamps[row - 1]:.12g} to {stamps[row]:.12g}"
        )
    if not 0.0 < times[-1] <= LONGEST_S:
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' spans {times[-1]:g} s when it is in {unit}; "
            f"say its unit: {', '.join(TIME_UNITS)}"
        )
    where = f" of {source.path.name}" if how.time_file else ""
    return times, f"time '{column}'{where} [{unit}]"


def _poses(table: Table, columns: Columns, how: PoseFileFormat, start: Array | None) -> Array:
    """Poses (N, 4, 4) in metres, with what is missing from the start pose."""
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
    if not how.units and largest > LARGEST_POSITION_M:
        raise TrajectoryFileError(
            f"{table.path.name}: positions reach {largest:g}, further than an arm in metres; "
            f"say the unit of length: {', '.join(LENGTH_UNITS)}"
        )
    poses[:, : position.shape[1], 3] = position * LENGTH_UNITS[how.units or "m"]
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


def _window(times: Array, how: PoseFileFormat, name: str) -> slice:
    end_s = float(times[-1]) if how.end_s is None else how.end_s
    first, last = int(np.searchsorted(times, how.start_s)), int(np.searchsorted(times, end_s, side="right"))
    if last - first < 2 or times[first] == times[last - 1]:
        raise TrajectoryFileError(
            f"{name}: no motion between start_s {how.start_s:g} and end_s {end_s:g}; it lasts {times[-1]:.4g} s"
        )
    return slice(first, last)


def _place(poses: Array, how: PoseFileFormat, start: Array | None, name: str) -> None:
    """Scale, lay onto the start pose and move, in place."""
    first = poses[0].copy()
    poses[:, :3, 3] = first[:3, 3] + how.scale * (poses[:, :3, 3] - first[:3, 3])
    if how.relative:
        if start is None:
            raise TrajectoryFileError(f"{name}: relative needs the arm's start pose")
        poses[:, :3, 3] += start[:3, 3] - first[:3, 3]
        poses[:, :3, :3] = poses[:, :3, :3] @ (first[:3, :3].T @ start[:3, :3])
    poses[:, :3, 3] += how.offset


def _description(
    table: Table, columns: Columns, how: PoseFileFormat, timing: str, duration_s: float, count: int
) -> str:
    parts = [f"{count} samples over {duration_s:.4g} s", timing]
    parts.append(f"position {', '.join(columns.position)} [{how.units or 'm'}]")
    parts.append(
        f"quaternion {', '.join(columns.quaternion)} [{columns.order}]" if columns.quaternion else "orientation held"
    )
    if len(columns.position) == 2:
        parts.append("z held")
    if how.relative:
        parts.append("relative to the start pose")
    if table.note:
        parts.insert(0, table.note)
    return f"{table.path.name}: " + "; ".join(parts)

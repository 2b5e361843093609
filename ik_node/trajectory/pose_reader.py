"""The reader of all files of poses: CSV, text, NPY, JSON and ROS bags.

A table is read from the file, its columns are detected or taken from a :class:`PoseFileFormat`, and converted to m, rad
and ns. The demonstration, the ground truth of reports and the replay use this reader.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError, TrajectoryFileError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.trajectory import pose_columns
from ik_node.trajectory.column_names import parse_name
from ik_node.trajectory.orientations import rotations
from ik_node.trajectory.pose_bag import RECEIVED, bag_table, is_bag
from ik_node.trajectory.pose_columns import MATRIX, QUATERNION, ROTATION_VECTOR, RPY, PoseColumns
from ik_node.trajectory.pose_file_format import (
    ANGLE_UNITS,
    LENGTH_UNITS,
    MAX_DURATION_S,
    NO_COLUMN,
    ORDERS,
    TIME_UNITS,
    PoseFileFormat,
    flag,
)
from ik_node.trajectory.pose_json import json_table
from ik_node.trajectory.pose_table import PoseTable
from ik_node.trajectory.pose_text import array_table, one_demonstration, text_table

READABLE = "CSV, text, JSON, NPY, and ROS bags"
LARGEST_POSITION_M = 3.0
"""Largest plausible position in metres if the file does not state a unit."""
LARGEST_ANGLE_RAD = 2.0 * np.pi + 1e-3
"""Largest plausible angle in radians of a rotation vector if the file does not state a unit."""
MAX_PERIOD_S = 1.0
"""Largest plausible median time between samples in seconds if the file does not state a unit of time."""
EPOCH_S = (946684800.0, 4102444800.0)
"""The years 2000 to 2100 in seconds since 1970: times in this range, in whichever unit, have only this unit."""


class PoseSamples(NamedTuple):
    """The poses of a file, in the order of their times."""

    name: str
    """Name of the file, for messages."""
    stamps_ns: NDArray[np.int64] | None
    """Times (N,), ns, not decreasing; None if the file has none."""
    position: Array
    """(N, 3), or (N, 2) for x and y, m."""
    rotation: Array | None
    """(N, 3, 3); None if the file has no orientation."""
    description: tuple[str, ...]
    """What was read: parts of a sentence."""


def read_table(path: Path, demo: int | None = None, topic: str = "") -> PoseTable:
    """Reads the table of a file of any kind.

    Args:
        path: The file.
        demo: Number of the demonstration, from 0.
        topic: Topic of a bag.

    Raises:
        TrajectoryFileError: The file cannot be read as a table, or an argument has no effect on it.
        RecordingError: The file is a bag that cannot be read.
    """
    if is_bag(path):
        if demo is not None:
            raise one_demonstration(path, demo)
        return bag_table(path, topic)
    if topic:
        raise TrajectoryFileError(f"{path.name} is no bag; --topic has no effect")
    try:
        if path.suffix.lower() == ".npy":
            return array_table(path, demo)
        text = path.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TrajectoryFileError(f"{path.name} is no text (byte {error.start}); readable: {READABLE}") from error
    except (OSError, ValueError) as error:
        if isinstance(error, TrajectoryFileError):
            raise
        reason = error.strerror if isinstance(error, OSError) else error
        raise TrajectoryFileError(f"{path} cannot be read: {reason}") from error
    if path.suffix.lower() in (".json", ".jsonl", ".ndjson") or text.lstrip()[:1] in ("{", "["):
        return json_table(path, text, demo)
    if demo is not None:
        raise one_demonstration(path, demo)
    return text_table(path, text)


def read_poses(path: str | Path, file_format: PoseFileFormat | None = None) -> PoseSamples:
    """Reads the poses of a file.

    Args:
        path: The file, or the folder of a bag.
        file_format: Format of the file; default: detected.

    Returns:
        The poses as they are in the file, in m, rad and ns.

    Raises:
        TrajectoryFileError: The file does not have the format, its units or conventions are ambiguous, an option has no
            effect, times decrease, or a number is not finite. The message states the column or sample, and what to
            give.
        RecordingError: The file is a bag that cannot be read.
    """
    file, file_format = Path(path), file_format or PoseFileFormat()
    table = read_table(file, file_format.demo, file_format.topic)
    if len(table) < 2:
        raise TrajectoryFileError(f"{file.name} holds {len(table)} sample; a motion needs two")
    columns = _columns(table, file_format)
    stamps_ns, timing = _stamps(table, columns, file_format)
    position, length = _position(table, columns, file_format)
    rotation, form = _rotation(table, columns, file_format)
    parts = (table.note, columns.layout, timing, f"position {', '.join(columns.position)} [{length}]", form)
    return PoseSamples(file.name, stamps_ns, position, rotation, tuple(filter(None, parts)))


# --- columns ---------------------------------------------------------------------------------------------------------


def _columns(table: PoseTable, file_format: PoseFileFormat) -> PoseColumns:
    """Explicit columns if given, detected ones otherwise."""
    explicit = _explicit_rotation(file_format)
    found, is_unclear = _detected(table, file_format, is_orientation_given=explicit is not None)
    if explicit is not None:
        columns, form = explicit
        if not (columns or found.rotation or file_format.position or is_unclear):
            _no_effect(table, "quaternion", "the file has no orientation")
        found = found._replace(rotation=tuple(map(table.name_of, columns)), form=form)
    if file_format.order:
        if found.form != QUATERNION and not (found.form in ORDERS and found.layout):
            reason = "the names of the columns state the order" if found.form in ORDERS else "no quaternion is read"
            _no_effect(table, "order", reason)
        found = found._replace(form=file_format.order)
    if found.form == QUATERNION:
        raise TrajectoryFileError(
            f"{table.path.name}: the order of the quaternion in columns {', '.join(found.rotation)} is not known; "
            f"give --order {' or '.join(ORDERS)}"
        )
    if file_format.time:
        if file_format.time == NO_COLUMN and not (found.time or file_format.position):
            _no_effect(table, "time", "the file has no time")
        time = file_format.time
        named = table if not file_format.time_file else None
        found = found._replace(time=() if time == NO_COLUMN else (named.name_of(time) if named else time,))
    return found


def _detected(table: PoseTable, file_format: PoseFileFormat, *, is_orientation_given: bool) -> tuple[PoseColumns, bool]:
    """The pose, and whether there are columns that may be an orientation; these must be given then."""
    try:
        if file_format.position:
            return _given_position(table, file_format), False
        return pose_columns.detect(table, file_format.prefix), False
    except pose_columns.UnknownOrientationError as error:
        if not is_orientation_given:
            raise
        return error.found, True


def _given_position(table: PoseTable, file_format: PoseFileFormat) -> PoseColumns:
    """The pose whose position is in the given columns."""
    position = tuple(map(table.name_of, file_format.position))
    if file_format.prefix:
        _no_effect(table, "prefix", "--position names the columns")
    if table.named:
        return pose_columns.beside(table, position)
    if _explicit_rotation(file_format) is None and any(
        layout.form == MATRIX and layout.width == len(table.names) for layout in pose_columns.LAYOUTS
    ):
        layout = pose_columns.by_layout(table).layout
        _no_effect(table, "position", f"{len(table.names)} columns are pose matrices ({layout})")
    missing = [
        name
        for name, given in (
            ("--quaternion (or none), --rpy or --rotation-vector", _explicit_rotation(file_format) is not None),
            ("--time (or none)", file_format.time or file_format.time_file),
        )
        if not given
    ]
    if missing and len(table.names) > len(position):
        raise TrajectoryFileError(
            f"{table.path.name} has {len(table.names)} columns without names; with --position also give "
            f"{' and '.join(missing)}"
        )
    return PoseColumns(position)


def _explicit_rotation(file_format: PoseFileFormat) -> tuple[tuple[str, ...], str] | None:
    """Columns and form of an orientation that is given; no columns to keep the orientation; None if not given."""
    if file_format.quaternion == (NO_COLUMN,):
        return (), ""
    if file_format.quaternion:
        axes = "".join(name[-1].lower() for name in file_format.quaternion if not name.isdecimal())
        return file_format.quaternion, axes if axes in ORDERS else QUATERNION
    if file_format.rpy:
        return file_format.rpy, RPY
    return (file_format.rotation_vector, ROTATION_VECTOR) if file_format.rotation_vector else None


# --- units -----------------------------------------------------------------------------------------------------------


def _position(table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat) -> tuple[Array, str]:
    """Position in m, and the unit of the file."""
    values = table.block(columns.position)
    units = [_stated_unit(table, name, LENGTH_UNITS) for name in columns.position]
    if file_format.units and all(units):
        _no_effect(table, "units", f"the names of the columns state {', '.join(dict.fromkeys(units))}")
    if not file_format.units:
        unstated = [index for index, unit in enumerate(units) if not unit]
        largest = float(np.abs(values[:, unstated]).max()) if unstated else 0.0
        if largest > LARGEST_POSITION_M:
            raise TrajectoryFileError(
                f"{table.path.name}: positions reach {largest:g}, further than an arm in metres; "
                f"give the unit of length, --units: {', '.join(LENGTH_UNITS)}"
            )
    used = [unit or file_format.units or "m" for unit in units]
    return values * [LENGTH_UNITS[unit] for unit in used], ", ".join(dict.fromkeys(used))


def _rotation(table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat) -> tuple[Array | None, str]:
    """Rotation matrices, and a description."""
    if file_format.angle_unit and columns.form not in (RPY, ROTATION_VECTOR):
        _no_effect(table, "angle_unit", "no angles are read")
    if not columns.form:
        return None, "orientation held"
    values, unit = table.block(columns.rotation), columns.form
    if columns.form in (RPY, ROTATION_VECTOR):
        units = [_stated_unit(table, name, ANGLE_UNITS) for name in columns.rotation]
        if file_format.angle_unit and all(units):
            _no_effect(table, "angle_unit", f"the names of the columns state {', '.join(dict.fromkeys(units))}")
        small = float(np.linalg.norm(values, axis=1).max()) <= LARGEST_ANGLE_RAD
        usual = "rad" if columns.form == ROTATION_VECTOR and small else ""
        used = [unit or file_format.angle_unit or usual for unit in units]
        if not all(used):
            raise TrajectoryFileError(
                f"{table.path.name}: the unit of {', '.join(columns.rotation)} is not known; "
                f"give --angle-unit {' or '.join(ANGLE_UNITS)}"
            )
        values, unit = values * [ANGLE_UNITS[unit] for unit in used], ", ".join(dict.fromkeys(used))
    try:
        found = rotations(values, columns.form)
    except InputError as error:
        raise TrajectoryFileError(f"{table.path.name}: {error}") from error
    name = {MATRIX: "matrix", RPY: "angles", ROTATION_VECTOR: "rotation vector"}.get(columns.form, "quaternion")
    listed = f"{columns.rotation[0]} ... {columns.rotation[-1]}" if name == "matrix" else ", ".join(columns.rotation)
    return found, f"{name} {listed}" + ("" if name == "matrix" else f" [{unit}]")


def _stated_unit(table: PoseTable, name: str, valid: dict[str, float]) -> str:
    """The unit in the name of a column; empty for none."""
    unit = parse_name(name).unit if table.named else ""
    if unit and unit not in valid:
        raise TrajectoryFileError(
            f"{table.path.name}: unit '{unit}' of column '{name}' is not known; valid: {', '.join(valid)}"
        )
    return unit


def _no_effect(table: PoseTable, option: str, reason: str) -> None:
    raise TrajectoryFileError(f"{table.path.name}: {flag(option)} has no effect: {reason}")


# --- times -----------------------------------------------------------------------------------------------------------


def _stamps(
    table: PoseTable, columns: PoseColumns, file_format: PoseFileFormat
) -> tuple[NDArray[np.int64] | None, str]:
    """Times in ns (N,), and a description of their origin; None and an empty one without times."""
    source = read_table(Path(file_format.time_file)) if file_format.time_file else table
    if len(source) != len(table):
        raise TrajectoryFileError(
            f"{source.path.name} holds {len(source)} samples, {table.path.name} holds {len(table)}; expected as many"
        )
    names = columns.time
    if file_format.time_file:
        given = () if not file_format.time else (source.name_of(file_format.time),)
        names = given or pose_columns.named_time(source) or source.names[:1]
    if not names:
        if file_format.time_unit:
            _no_effect(table, "time_unit", "no time is read")
        return None, ""
    stated = [_stated_unit(source, name, TIME_UNITS) for name in names]
    if len(names) == 2:
        stated = ["s", "ns"]
    if file_format.time_unit and all(stated):
        _no_effect(source, "time_unit", f"'{', '.join(names)}' states {' and '.join(stated)}")
    units = [
        unit or file_format.time_unit or _epoch_unit(source.column(name))
        for name, unit in zip(names, stated, strict=True)
    ]
    stamps = sum(
        (
            source.nanoseconds(name, round(TIME_UNITS[unit or "s"] * NS))
            for name, unit in zip(names, units, strict=True)
        ),
        start=np.zeros(len(source), np.int64),
    )
    _check_times(source, names, stamps, ", ".join(unit or "s" for unit in units), known=all(units))
    where = f" of {source.path.name}" if file_format.time_file else ""
    return stamps, f"time '{', '.join(names)}'{where} [{', '.join(unit or 's' for unit in units)}]"


def _epoch_unit(stamps: Array) -> str:
    """The unit of times since 1970; empty if they are none."""
    lowest, highest = float(stamps.min()), float(stamps.max())
    for unit, seconds in TIME_UNITS.items():
        if EPOCH_S[0] <= lowest * seconds and highest * seconds <= EPOCH_S[1]:
            return unit
    return ""


def _check_times(
    source: PoseTable, names: tuple[str, ...], stamps_ns: NDArray[np.int64], unit: str, *, known: bool
) -> None:
    column = ", ".join(names)
    steps_ns = np.diff(stamps_ns)
    backwards = np.flatnonzero(steps_ns < 0)
    if backwards.size:
        row = int(backwards[0]) + 1
        before, after = (source.column(names[0])[index] for index in (row - 1, row))
        other = f"; or give --time {RECEIVED}" if RECEIVED in source.names and RECEIVED not in names else ""
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' goes backwards at sample {row}, "
            f"from {before:.12g} to {after:.12g}{other}"
        )
    span_s, period_s = float(stamps_ns[-1] - stamps_ns[0]) / NS, float(np.median(steps_ns)) / NS
    if not 0.0 < span_s <= MAX_DURATION_S:
        raise TrajectoryFileError(
            f"{source.path.name}: the time in column '{column}' spans {span_s:g} s when it is in {unit}; "
            f"say its unit, --time-unit: {', '.join(TIME_UNITS)}; or --time none"
        )
    if not known and period_s > MAX_PERIOD_S:
        raise TrajectoryFileError(
            f"{source.path.name}: the samples are {period_s:g} s apart if the time in column '{column}' is in s; "
            f"say its unit, --time-unit: {', '.join(TIME_UNITS)}"
        )

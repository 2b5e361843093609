"""Detection of the columns of position, orientation and time in a table.

If the file has names of columns, these decide (:mod:`~ik_node.trajectory.column_names`). Otherwise
:data:`LAYOUTS` decides, the table of the recognised formats without names. What may be an orientation and cannot be
read as one raises an error: it is not left out.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ik_node.errors import TrajectoryFileError
from ik_node.math import se3
from ik_node.trajectory.column_names import (
    ANGLES,
    POSITION_WORDS,
    QUATERNION_WORDS,
    ROTATION_VECTOR_WORDS,
    ColumnName,
    is_rotation_like,
    is_time,
    parse_name,
)
from ik_node.trajectory.pose_file_format import ORDERS
from ik_node.trajectory.pose_table import PoseTable

GOAL_WORDS = ("goal", "target", "desired", "command")
"""Among several poses, one whose name has such a word is the pose to follow."""
QUATERNION, RPY, ROTATION_VECTOR, MATRIX = "quaternion", "roll, pitch, yaw", "rotation vector", "matrix"
"""Forms of an orientation beside :data:`~ik_node.trajectory.pose_file_format.ORDERS`; the first: order unknown."""


class UnknownOrientationError(TrajectoryFileError):
    """Columns may be an orientation, and their convention is not known."""

    def __init__(self, message: str, found: PoseColumns) -> None:
        """Store the pose without these columns."""
        super().__init__(message)
        self.found = found


class Layout(NamedTuple):
    """A format of files without names of columns."""

    name: str
    width: int
    """Number of columns."""
    time: tuple[int, ...] = ()
    """Column of the time; two: of seconds and nanoseconds."""
    position: tuple[int, ...] = ()
    rotation: tuple[int, ...] = ()
    form: str = ""
    blanks: bool = False
    """Only if blanks separate the columns."""
    text: tuple[int, ...] = ()
    """Columns that hold words."""


LAYOUTS = (
    Layout("x, y", 2, position=(0, 1)),
    Layout("x, y, z", 3, position=(0, 1, 2)),
    Layout("x, y, z, quaternion", 7, position=(0, 1, 2), rotation=(3, 4, 5, 6), form=QUATERNION),
    Layout("TUM", 8, (0,), (1, 2, 3), (4, 5, 6, 7), "xyzw", blanks=True),
    Layout("time, x, y, z, quaternion", 8, (0,), (1, 2, 3), (4, 5, 6, 7), QUATERNION),
    Layout("PoseStamped of ros2 topic echo --csv", 10, (0, 1), (3, 4, 5), (6, 7, 8, 9), "xyzw", text=(2,)),
    Layout("TransformStamped of ros2 topic echo --csv", 11, (0, 1), (4, 5, 6), (7, 8, 9, 10), "xyzw", text=(2, 3)),
    Layout("KITTI", 12, rotation=tuple(range(12)), form=MATRIX),
    Layout("time, KITTI", 13, (0,), rotation=tuple(range(1, 13)), form=MATRIX),
    Layout("4x4 matrices", 16, rotation=tuple(range(16)), form=MATRIX),
    Layout("time, 4x4 matrices", 17, (0,), rotation=tuple(range(1, 17)), form=MATRIX),
)
"""The recognised formats without names of columns; lengths in m."""


class PoseColumns(NamedTuple):
    """Names of the columns of a pose; empty for those that the file does not have."""

    position: tuple[str, ...] = ()
    rotation: tuple[str, ...] = ()
    """Columns of the orientation; of a matrix the nine entries, row by row."""
    form: str = ""
    """Form of the orientation: one of ``ORDERS``, or of the forms above; empty for none."""
    time: tuple[str, ...] = ()
    """Column of the time; two: of seconds and nanoseconds."""
    layout: str = ""
    """Name of the layout, of a file without names."""


def detect(table: PoseTable, prefix: str = "") -> PoseColumns:
    """Detects the columns of a pose.

    Args:
        table: The table.
        prefix: Prefix of the names of the columns to consider.

    Returns:
        The columns.

    Raises:
        TrajectoryFileError: There is no pose, or several of which none is the only goal, or a prefix has no effect.
    """
    if not table.named:
        if prefix:
            raise TrajectoryFileError(f"{table.path.name} has no names of columns; --prefix has no effect")
        return by_layout(table)
    columns = [parse_name(name) for name in table.names]
    candidates = _positions(table, columns)
    if prefix and len(candidates) == 1:
        raise TrajectoryFileError(f"{table.path.name} has one pose per row; --prefix has no effect")
    candidates = {key: found for key, found in candidates.items() if found.position[0].startswith(prefix)}
    if not candidates:
        which = f" that begins with '{prefix}'" if prefix else ""
        raise TrajectoryFileError(
            f"{table.path.name}: no position x, y, z{which} among its columns; name them (--position); "
            f"there are: {', '.join(table.names)}"
        )
    if len(candidates) > 1:
        goals = {key: found for key, found in candidates.items() if any(g in "_".join(key) for g in GOAL_WORDS)}
        if len(goals) != 1:
            listed = ", ".join(f"'{_stem(found.position[0])}'" for found in candidates.values())
            raise TrajectoryFileError(f"{table.path.name}: several positions; choose one by its --prefix: {listed}")
        candidates = goals
    root, found = next(iter(candidates.items()))
    return _completed(table, columns, root, found)


def beside(table: PoseTable, position: tuple[str, ...]) -> PoseColumns:
    """The pose of a table with names whose position is in the given columns."""
    columns = [parse_name(name) for name in table.names]
    first = parse_name(position[0])
    return _completed(table, columns, first.root, PoseColumns(position))


def by_layout(table: PoseTable) -> PoseColumns:
    """The pose of a table without names; raises TrajectoryFileError when no layout fits."""
    words = tuple(index for index, name in enumerate(table.names) if table.is_text(name))
    for layout in LAYOUTS:
        if layout.width == len(table.names) and layout.text == words and (table.blanks or not layout.blanks):
            time, position, rotation = (
                tuple(table.names[index] for index in part) for part in (layout.time, layout.position, layout.rotation)
            )
            found = PoseColumns(position, rotation, layout.form, time, layout.name)
            return _from_matrix(table, found) if layout.form == MATRIX else found
    if words and layout_width(table):
        name = table.names[words[0]]
        raise TrajectoryFileError(
            f"{table.path.name}: sample 0, column '{name}' holds '{table.rows[0][words[0]]}', not a number"
        )
    raise TrajectoryFileError(
        f"{table.path.name} has {len(table.names)} columns without names; say which are --position, --time (or none) "
        "and --quaternion (or none), --rpy or --rotation-vector: 0, 1, 2, ..."
    )


def layout_width(table: PoseTable) -> bool:
    """Whether a layout has as many columns as the table."""
    return any(layout.width == len(table.names) for layout in LAYOUTS)


def named_time(table: PoseTable, root: tuple[str, ...] = ()) -> tuple[str, ...]:
    """The time column of a table with names; two if they hold seconds and nanoseconds; empty for none.

    Args:
        table: The table.
        root: Root of the pose; among times with a root, one with this root is preferred.
    """
    if not table.named:
        return ()
    times = [column for column in map(parse_name, table.names) if is_time(column)]
    times.sort(key=lambda column: (bool(column.root), column.root[: len(root)] != root))
    if not times:
        return ()
    first = times[0]
    alike = [column for column in times if (column.root, column.word) == (first.root, first.word)]
    spelled = [column.name.lower() for column in alike]
    if len(alike) == 2 and {column.unit for column in alike} == {"s", "ns"} and all("sec" in name for name in spelled):
        return tuple(column.name for column in sorted(alike, key=lambda column: column.unit, reverse=True))
    return (first.name,)


def _positions(table: PoseTable, columns: list[ColumnName]) -> dict[tuple[str, ...], PoseColumns]:
    """Root -> position, for every pose of a table with names."""
    found: dict[tuple[str, ...], PoseColumns] = {}
    for (root, word), group in _groups(columns).items():
        axes = {column.axis: column.name for column in group}
        numbers = _numbers(group)
        position: tuple[str, ...] = ()
        own = (*root, word)
        if word in POSITION_WORDS and {"x", "y"} <= axes.keys() and "w" not in axes:
            _refuse_double(table, group)
            position = tuple(axes[axis] for axis in "xyz" if axis in axes)
        elif word in POSITION_WORDS and len(numbers) == 3:
            position = tuple(numbers)
        elif word in ("pose", "poses") and len(numbers) == 7:
            found[own] = PoseColumns(tuple(numbers[:3]), tuple(numbers[3:]), QUATERNION)
        elif len(numbers) in (12, 16):
            found[own] = _from_matrix(table, PoseColumns((), tuple(numbers), MATRIX))
        if position:
            found.setdefault(root, PoseColumns(position))
    return found


def _completed(table: PoseTable, columns: list[ColumnName], root: tuple[str, ...], found: PoseColumns) -> PoseColumns:
    """The pose with orientation and time."""
    if not found.form:
        others = [column for column in columns if column.name not in found.position]
        rotation, form = _rotation(table, others, root)
        found = found._replace(rotation=rotation, form=form)
    found = found._replace(time=named_time(table, root))
    unread = [] if found.form else _unread(columns, root)
    if unread:
        raise UnknownOrientationError(
            f"{table.path.name}: {', '.join(unread)} may be an orientation; give its columns with --quaternion, --rpy "
            "or --rotation-vector; or --quaternion none to keep the orientation",
            found,
        )
    return found


def _rotation(table: PoseTable, columns: list[ColumnName], root: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    """Columns and form of the orientation below a root; empty if there is none."""
    own = [column for column in columns if column.root == root]
    candidates: list[tuple[tuple[str, ...], str]] = []
    for (_, word), group in _groups(own).items():
        axes, numbers = {column.axis: column.name for column in group}, _numbers(group)
        if {"w", "x", "y", "z"} <= axes.keys():
            _refuse_double(table, group)
            candidates.append((tuple(axes[axis] for axis in "xyzw"), "xyzw"))
        elif word in QUATERNION_WORDS and len(numbers) == 4:
            candidates.append((numbers, word if word in ORDERS else QUATERNION))
        elif len(numbers) == 9:
            candidates.append((numbers, MATRIX))
        elif word in ROTATION_VECTOR_WORDS and ({"x", "y", "z"} <= axes.keys() or len(numbers) == 3):
            candidates.append((numbers or tuple(axes[axis] for axis in "xyz"), ROTATION_VECTOR))
        elif word == "rpy" and len(numbers) == 3:
            candidates.append((numbers, RPY))
    angles = {column.axis: column.name for column in own if column.axis in ANGLES}
    if len(angles) == len(ANGLES):
        _refuse_double(table, [column for column in own if column.axis in ANGLES])
        candidates.append((tuple(angles[axis] for axis in ANGLES), RPY))
    if candidates:
        rank = (*ORDERS, MATRIX, QUATERNION, ROTATION_VECTOR, RPY)
        return min(candidates, key=lambda candidate: rank.index(candidate[1]))
    return (), ""


def _unread(columns: list[ColumnName], root: tuple[str, ...]) -> list[str]:
    """Names of the columns that may be an orientation of the pose below a root."""
    found = [column for column in columns if column.root in ((), root) and is_rotation_like(column)]
    numbered = [column.name for column in found if column.word == "q" and column.numbers]
    joints = numbered if len(numbered) not in (3, 4) else []  # q1 to q7 are joint positions
    unread = [column.name for column in found if column.name not in joints]
    letters = [column.name for column in columns if column.name.lower() in ("a", "b", "c")]
    return unread + (letters if len(letters) == 3 else [])


def _from_matrix(table: PoseTable, found: PoseColumns) -> PoseColumns:
    """Position and rotation of 12 or 16 columns that hold the entries of a pose matrix.

    16 columns may be stored row by row or column by column; the row 0 0 0 1 shows which.
    """
    names, entries = found.rotation, table.block(found.rotation)
    if len(names) == 16:
        wanted = np.array([0.0, 0.0, 0.0, 1.0])
        by_rows, by_columns = (
            bool((np.abs(entries[:, part] - wanted) <= se3.ROTATION_TOLERANCE).all())
            for part in ([12, 13, 14, 15], [3, 7, 11, 15])
        )
        if not (by_rows or by_columns):
            raise TrajectoryFileError(
                f"{table.path.name}: columns {names[0]} to {names[-1]} are no pose matrices: no row is 0 0 0 1"
            )
        digits = parse_name(names[0]).numbers if table.named else ()
        if by_rows and by_columns and not (table.matrices or len("".join(digits)) == 2):
            raise TrajectoryFileError(
                f"{table.path.name}: columns {names[0]} to {names[-1]} are rotations stored by rows or by columns; "
                "without a translation the file does not show which"
            )
        if not by_rows:
            names = tuple(names[4 * (index % 4) + index // 4] for index in range(16))
    return found._replace(position=(names[3], names[7], names[11]), rotation=(*names[0:3], *names[4:7], *names[8:11]))


def _groups(columns: Iterable[ColumnName]) -> dict[tuple[tuple[str, ...], str], list[ColumnName]]:
    """Root and word -> the columns with an axis or index."""
    groups: dict[tuple[tuple[str, ...], str], list[ColumnName]] = {}
    for column in columns:
        if column.axis in (*"xyzw",) or column.numbers:
            groups.setdefault((column.root, column.word), []).append(column)
    return groups


def _numbers(group: list[ColumnName]) -> tuple[str, ...]:
    """The columns in the order of their numbers, if these are those of a vector or matrix, from 0 or 1; else empty."""
    numbered = [column for column in group if column.numbers]
    keys = [column.numbers if len(column.numbers) == 2 else tuple(column.numbers[0]) for column in numbered]
    for shape in ((3, 3), (3, 4), (4, 4)):
        for first in (0, 1):
            pairs = [(str(i + first), str(j + first)) for i in range(shape[0]) for j in range(shape[1])]
            if sorted(keys) == pairs:
                return tuple(numbered[keys.index(pair)].name for pair in pairs)
    singles = [int(column.numbers[0]) for column in numbered if len(column.numbers) == 1]
    for first in (0, 1):
        if len(singles) == len(numbered) > 0 and sorted(singles) == list(range(first, first + len(singles))):
            return tuple(numbered[singles.index(number)].name for number in sorted(singles))
    return ()


def _refuse_double(table: PoseTable, group: list[ColumnName]) -> None:
    axes = [column.axis for column in group]
    for column in group:
        if axes.count(column.axis) > 1:
            double = ", ".join(f"'{other.name}'" for other in group if other.axis == column.axis)
            raise TrajectoryFileError(f"{table.path.name}: several columns for one axis: {double}; give --position")


def _stem(name: str) -> str:
    """What a prefix can be: the name without axis, word and the separators before it."""
    column = parse_name(name)
    end = name.lower().rfind(column.word) if column.word else -1
    return name[:end] if end > 0 else name[:-1].rstrip("_./- ")

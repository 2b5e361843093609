"""Detection of the columns of position, quaternion and time in a table.

If the file has names of columns, these decide: ``x y z``, ``tx ty tz``, ``pos_x ...``, ``pose.position.x ...`` make a
position, four names that end in w, x, y, z a quaternion of that order. Otherwise the number of columns decides.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from ik_node.errors import TrajectoryFileError
from ik_node.trajectory.pose_file_format import TIME_UNITS
from ik_node.trajectory.pose_table import PoseTable

POSITION_WORDS = ("", "t", "p", "pos", "position", "trans", "translation")
"""Text before x, y, z in the names of a position."""
GOAL_WORDS = ("goal", "target", "desired", "command")
"""Among several poses, one whose name has such a word is the pose to follow."""
TIME_WORDS = ("time", "timestamp", "stamp", "t", "ros", "log", "sec")
"""Names of a time column, alone or followed by a unit."""
LAYOUTS: dict[int, tuple[bool, int, int]] = {2: (False, 2, 0), 3: (False, 3, 0), 7: (False, 3, 4), 8: (True, 3, 4)}
"""Number of unnamed columns -> whether the first is the time, number of columns of position and quaternion."""


class PoseColumns(NamedTuple):
    """Names of the columns of a pose; empty for those that the file does not have."""

    position: tuple[str, ...] = ()
    quaternion: tuple[str, ...] = ()
    order: str = ""
    """Order of the quaternion, "xyzw" or "wxyz"; empty if the names do not define it."""
    time: str = ""
    time_unit: str = ""


def detect(table: PoseTable, prefix: str = "") -> PoseColumns:
    """Detects the columns of a pose.

    Args:
        table: The table.
        prefix: Prefix of the names of the columns to consider.

    Returns:
        The columns.

    Raises:
        TrajectoryFileError: There is no pose, or several of which none is the only goal.
    """
    if not table.named:
        return _by_count(table)
    time, unit = _time(table.names)
    candidates = _positions(tuple(name for name in table.names if name.startswith(prefix)))
    if not candidates:
        which = f" that begins with '{prefix}'" if prefix else ""
        raise TrajectoryFileError(
            f"{table.path.name}: no position x, y, z{which} among its columns; name them; "
            f"there are: {', '.join(table.names)}"
        )
    if len(candidates) > 1:
        goals = {root: found for root, found in candidates.items() if any(word in root.lower() for word in GOAL_WORDS)}
        if len(goals) != 1:
            listed = ", ".join(f"'{root}'" for root in candidates)
            raise TrajectoryFileError(f"{table.path.name}: several positions; choose one by its prefix: {listed}")
        candidates = goals
    root, position = next(iter(candidates.items()))
    quaternion, order = _quaternion(table.names, root)
    return PoseColumns(position, quaternion, order, time, unit)


def quaternion_beside(table: PoseTable, position: tuple[str, ...]) -> tuple[tuple[str, ...], str]:
    """Columns and order of the quaternion with the same prefix as ``position``; empty if there is none."""
    if not table.named or not position or position[0] not in table.names:
        return (), ""
    return _quaternion(table.names, _root(position[0][:-1]))


def named_time(table: PoseTable) -> tuple[str, str]:
    """Name and unit of the time column; empty if no name defines it."""
    return _time(table.names) if table.named else ("", "")


def time_unit(name: str) -> str:
    """Unit at the end of the name of a time column; empty if there is none."""
    last = re.split(r"[^a-z]+", name.lower())[-1]
    return last if last in TIME_UNITS and last != name.lower() else ""


def _by_count(table: PoseTable) -> PoseColumns:
    if len(table.names) not in LAYOUTS:
        raise TrajectoryFileError(
            f"{table.path.name} has {len(table.names)} columns without names; say which are the position (0, 1, 2, ...)"
        )
    timed, position, quaternion = LAYOUTS[len(table.names)]
    names = table.names[1:] if timed else table.names
    return PoseColumns(
        names[:position], names[position : position + quaternion], "", table.names[0] if timed else "", ""
    )


def _positions(names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Root -> the columns of a position, for names like root + "pos_" + x, y (and z)."""
    found: dict[str, tuple[str, ...]] = {}
    for name in names:
        stem = name[:-1]
        columns = tuple(stem + axis for axis in _axes(name, "xyz") if stem + axis in names)
        is_quaternion = any(stem + axis in names for axis in _axes(name, "w"))
        if name[-1] in "xX" and len(columns) >= 2 and not is_quaternion and _last_word(stem) in POSITION_WORDS:
            found.setdefault(_root(stem), columns)
    return found


def _quaternion(names: tuple[str, ...], root: str) -> tuple[tuple[str, ...], str]:
    for name in names:
        stem = name[:-1]
        columns = tuple(other for other in names if other[:-1] == stem and other[-1] in _axes(name, "wxyz"))
        order = "".join(other[-1] for other in columns).lower()
        if _root(stem) == root and sorted(order) == ["w", "x", "y", "z"]:
            return tuple(stem + axis for axis in _axes(name, "xyzw")), "xyzw"
    return (), ""


def _axes(name: str, letters: str) -> tuple[str, ...]:
    return tuple(letters.upper() if name[-1].isupper() else letters)


def _time(names: tuple[str, ...]) -> tuple[str, str]:
    for name in names:
        words = re.split(r"[^a-z]+", name.lower())
        if words[0] in TIME_WORDS and (len(words) == 1 or (len(words) == 2 and words[1] in TIME_UNITS)):
            return name, time_unit(name)
    return "", ""


def _last_word(stem: str) -> str:
    return re.split(r"[^a-z]+", stem.rstrip("_./- ").lower())[-1]


def _root(stem: str) -> str:
    """The name without its last word: "goal_pos_" -> "goal_", "pose.position." -> "pose.", "t" -> ""."""
    trimmed = stem.rstrip("_./- ")
    return trimmed[: len(trimmed) - len(_last_word(stem))]

"""How to read a file of poses. The fields of :class:`PoseFileFormat` are also command-line options.

This module imports the standard library only, so that a command line can print its help without loading NumPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from typing import Any

from ik_node.errors import TrajectoryFileError

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Unit -> metres."""
ORDERS = ("xyzw", "wxyz")
ANGLE_UNITS = {"rad": 1.0, "deg": math.pi / 180.0}
"""Unit -> radians."""
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Unit -> seconds."""
NO_COLUMN = "none"
"""Name of a column that means: do not use that of the file."""
DEFAULT_DURATION_S = 10.0
"""Duration of a motion without times in its file."""
MAX_DURATION_S = 86400.0
"""Longest plausible duration; beyond it the assumed unit of time is wrong."""


def option(default: Any, about: str, choices: tuple[str, ...] = (), *, motion: bool = False) -> Any:
    """Return a field of :class:`PoseFileFormat`.

    Args:
        default: Value of an option that is not given.
        about: Help text of the command-line option.
        choices: Valid values; empty: any.
        motion: The option changes the motion; the others say how the file is read.
    """
    return field(default=default, metadata={"description": about, "choices": choices, "motion": motion})


@dataclass(frozen=True)
class PoseFileFormat:
    """Format of a file of poses. Empty fields are detected from the file; ``describe()`` of the trajectory lists them.

    Columns are names, or numbers counted from 0. Where the file has no z or no orientation, those of the start pose of
    the arm are used. A field that has no effect on the file raises TrajectoryFileError when the file is read.
    """

    prefix: str = option("", "prefix of the names of the columns, if the file has several poses per row")
    topic: str = option("", "topic of the poses in a bag; for transforms TOPIC:CHILD_FRAME")
    position: tuple[str, ...] = option((), "columns x, y and z; or x and y")
    quaternion: tuple[str, ...] = option((), f"four columns of the quaternion; or {NO_COLUMN}: keep the orientation")
    rpy: tuple[str, ...] = option((), "columns roll, pitch and yaw: angles about the fixed axes x, y, z, in this order")
    rotation_vector: tuple[str, ...] = option((), "three columns of the rotation vector (axis times angle)")
    order: str = option("", "order of the columns of the quaternion", ORDERS)
    units: str = option("", "unit of length in the file; default: m", tuple(LENGTH_UNITS))
    angle_unit: str = option("", "unit of roll, pitch and yaw, or of the rotation vector", tuple(ANGLE_UNITS))
    time: str = option("", f"column of time; or {NO_COLUMN}: samples are evenly spaced")
    time_unit: str = option("", "unit of that column; default: as its name says, or s", tuple(TIME_UNITS))
    time_file: str = option("", "other file that has the column of time, row by row")
    demo: int | None = option(None, "index of the demonstration in an NPY file of several")
    duration_s: float | None = option(
        None,
        f"duration of the whole file; default: by its times, or {DEFAULT_DURATION_S:g} s without times",
        motion=True,
    )
    start_s: float = option(0.0, "start at this time of the motion, s", motion=True)
    end_s: float | None = option(None, "end at this time of the motion, s", motion=True)
    relative: bool = option(False, "move the first pose to the start pose of the arm", motion=True)
    scale: float = option(1.0, "scale the path about its first point; orientations are kept", motion=True)
    offset: tuple[float, float, float] = option(
        (0.0, 0.0, 0.0), "displacement of the path in the base frame, m", motion=True
    )

    def __post_init__(self) -> None:
        for name, value, valid in (
            ("order", self.order, ORDERS),
            ("units", self.units, tuple(LENGTH_UNITS)),
            ("angle_unit", self.angle_unit, tuple(ANGLE_UNITS)),
            ("time_unit", self.time_unit, tuple(TIME_UNITS)),
        ):
            if value and value not in valid:
                raise TrajectoryFileError(f"{name} is '{value}'; valid: {', '.join(valid)}")
        if len(self.position) not in (0, 2, 3):
            raise TrajectoryFileError(f"position names {len(self.position)} columns; expected 2 or 3")
        if len(self.quaternion) not in (0, 4) and self.quaternion != (NO_COLUMN,):
            raise TrajectoryFileError(f"quaternion names {len(self.quaternion)} columns; expected 4, or {NO_COLUMN}")
        for name, columns in (("rpy", self.rpy), ("rotation_vector", self.rotation_vector)):
            if len(columns) not in (0, 3):
                raise TrajectoryFileError(f"{name} names {len(columns)} columns; expected 3")
        given = [name for name in ("quaternion", "rpy", "rotation_vector") if getattr(self, name)]
        if len(given) > 1:
            raise TrajectoryFileError(f"{' and '.join(map(flag, given))} are given; expected one of them")
        if self.duration_s is not None and not 0.0 < self.duration_s <= MAX_DURATION_S:
            raise TrajectoryFileError(f"duration_s is {self.duration_s}; valid: above 0 to {MAX_DURATION_S:g}")
        numbers = (self.scale, self.start_s, *self.offset, 0.0 if self.end_s is None else self.end_s)
        if not all(map(math.isfinite, numbers)):
            raise TrajectoryFileError("scale, offset, start_s and end_s must be finite")

    def given(self) -> tuple[str, ...]:
        """Names of the fields that differ from their default."""
        return tuple(entry.name for entry in fields(self) if getattr(self, entry.name) != entry.default)


def flag(name: str) -> str:
    """The command-line option of a field: ``time_unit`` -> ``--time-unit``."""
    return "--" + name.removesuffix("_s").replace("_", "-")

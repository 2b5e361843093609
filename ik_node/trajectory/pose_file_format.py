"""How to read a file of poses. The fields of :class:`PoseFileFormat` are also command-line options.

This module imports the standard library only, so that a command line can print its help without loading NumPy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from ik_node.errors import TrajectoryFileError

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
"""Unit -> metres."""
ORDERS = ("xyzw", "wxyz")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Unit -> seconds."""
NO_COLUMN = "none"
"""Name of a column that means: do not use that of the file."""
DEFAULT_DURATION_S = 10.0
"""Duration of a motion without times in its file."""
MAX_DURATION_S = 86400.0
"""Longest plausible duration; beyond it the assumed unit of time is wrong."""


def option(default: Any, about: str, choices: tuple[str, ...] = ()) -> Any:
    """Return a field of :class:`PoseFileFormat` with the help text and choices of its command-line option."""
    return field(default=default, metadata={"description": about, "choices": choices})


@dataclass(frozen=True)
class PoseFileFormat:
    """Format of a file of poses. Empty fields are detected from the file; ``describe()`` of the trajectory lists them.

    Columns are names, or numbers counted from 0. Where the file has no z or no orientation, those of the start pose of
    the arm are used.
    """

    prefix: str = option("", "prefix of the names of the columns, if the file has several poses per row")
    position: tuple[str, ...] = option((), "columns x, y and z; or x and y")
    quaternion: tuple[str, ...] = option((), f"four columns of the quaternion; or {NO_COLUMN}")
    order: str = option("", "order of the columns of the quaternion", ORDERS)
    units: str = option("", "unit of length in the file; default: m", tuple(LENGTH_UNITS))
    time: str = option("", f"column of time; or {NO_COLUMN}: samples are evenly spaced")
    time_unit: str = option("", "unit of that column; default: s", tuple(TIME_UNITS))
    time_file: str = option("", "other file that has the column of time, row by row")
    demo: int = option(0, "index of the demonstration in an NPY file")
    duration_s: float | None = option(
        None, f"duration of the whole file; default: by its times, or {DEFAULT_DURATION_S:g} s without times"
    )
    start_s: float = option(0.0, "start at this time of the motion, s")
    end_s: float | None = option(None, "end at this time of the motion, s")
    relative: bool = option(False, "move the first pose to the start pose of the arm")
    scale: float = option(1.0, "scale the path about its first point; orientations are kept")
    offset: tuple[float, float, float] = option((0.0, 0.0, 0.0), "displacement of the path in the base frame, m")

    def __post_init__(self) -> None:
        for name, value, valid in (
            ("order", self.order, ORDERS),
            ("units", self.units, tuple(LENGTH_UNITS)),
            ("time_unit", self.time_unit, tuple(TIME_UNITS)),
        ):
            if value and value not in valid:
                raise TrajectoryFileError(f"{name} is '{value}'; valid: {', '.join(valid)}")
        if len(self.position) not in (0, 2, 3):
            raise TrajectoryFileError(f"position names {len(self.position)} columns; expected 2 or 3")
        if len(self.quaternion) not in (0, 4) and self.quaternion != (NO_COLUMN,):
            raise TrajectoryFileError(f"quaternion names {len(self.quaternion)} columns; expected 4, or {NO_COLUMN}")
        if self.duration_s is not None and not 0.0 < self.duration_s <= MAX_DURATION_S:
            raise TrajectoryFileError(f"duration_s is {self.duration_s}; valid: above 0 to {MAX_DURATION_S:g}")
        numbers = (self.scale, self.start_s, *self.offset, 0.0 if self.end_s is None else self.end_s)
        if not all(map(math.isfinite, numbers)):
            raise TrajectoryFileError("scale, offset, start_s and end_s must be finite")

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
"""Given as the quaternion's or time's column: the file's is not to be used."""
DEFAULT_DURATION_S = 10.0
"""Length of a motion whose file holds no time."""
LONGEST_S = 86400.0
"""Stamps that span more are not believed to be in the unit assumed."""


def option(default: Any, about: str, choices: tuple[str, ...] = ()) -> Any:
    """A field of :class:`PoseFileFormat` that a command line can offer."""
    return field(default=default, metadata={"description": about, "choices": choices})


@dataclass(frozen=True)
class PoseFileFormat:
    """How to read a file of poses. What is left empty is found out from the file, and said by ``describe()``.

    Columns are names, or numbers counted from 0. A file without z, or without orientation, takes them from the arm's
    start pose.
    """

    prefix: str = option("", "begin of the names of the columns to use, when the file holds several poses")
    position: tuple[str, ...] = option((), "columns x, y and z; two when there is no z")
    quaternion: tuple[str, ...] = option((), f"the quaternion's four columns; or {NO_COLUMN}")
    order: str = option("", "order of the quaternion's columns", ORDERS)
    units: str = option("", "unit of length in the file; default: m", tuple(LENGTH_UNITS))
    time: str = option("", f"column of time; or {NO_COLUMN}: samples are evenly spaced")
    time_unit: str = option("", "unit of that column; default: s", tuple(TIME_UNITS))
    time_file: str = option("", "file that holds the column of time, row by row, when it is another one")
    demo: int = option(0, "which demonstration of an NPY file")
    duration_s: float | None = option(
        None, f"play the whole file in this time; default: its own, or {DEFAULT_DURATION_S:g} s when it holds none"
    )
    start_s: float = option(0.0, "begin here, in seconds of the motion")
    end_s: float | None = option(None, "end here, in seconds of the motion")
    relative: bool = option(False, "lay the first pose onto the arm's start pose and keep the base's axes")
    scale: float = option(1.0, "enlarge the path about its first point; turns stay")
    offset: tuple[float, float, float] = option((0.0, 0.0, 0.0), "move the path, in metres along the base's axes")

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
        if self.duration_s is not None and not 0.0 < self.duration_s <= LONGEST_S:
            raise TrajectoryFileError(f"duration_s is {self.duration_s}; valid: above 0 to {LONGEST_S:g}")
        numbers = (self.scale, self.start_s, *self.offset, 0.0 if self.end_s is None else self.end_s)
        if not all(map(math.isfinite, numbers)):
            raise TrajectoryFileError("scale, offset, start_s and end_s must be finite")

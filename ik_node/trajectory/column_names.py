"""Meaning of the name of one column: quantity, axis and unit.

``goal_pos_x`` is the axis x of the word "pos" below the root "goal"; ``p_RS_R_x [m]``, ``pose.position.x``,
``/arm/pose/position/x``, ``tx (mm)``, ``yaw_deg`` and ``matrix.0.3`` are read in the same way.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from ik_node.trajectory.pose_file_format import ANGLE_UNITS, LENGTH_UNITS, ORDERS, TIME_UNITS

POSITION_WORDS = ("", "t", "p", "pos", "position", "positions", "trans", "translation", "point", "xyz")
"""Words of a position; the empty one for ``x``, ``y``, ``z`` alone."""
QUATERNION_WORDS = ("q", "quat", "quaternion", "orientation", "rotation", "rot", "ori", "xyzw", "wxyz")
"""Words of four numbered columns of a quaternion."""
ROTATION_VECTOR_WORDS = ("rotvec", "rotationvector", "axisangle")
ANGLES = ("roll", "pitch", "yaw")
TIME_WORDS = ("time", "timestamp", "stamp", "timestamps", "received")
"""Last word of a time, after any root."""
TIME_WORDS_ALONE = ("t", "ts", "ros", "log", "elapsed", "epoch", "clock")
"""Time only without a root."""
ROTATION_LIKE = (
    *("rot", "rotation", "ori", "orientation", "attitude", "quat", "quaternion", "euler", "rpy", "ypr", "angle"),
    *("angles", "heading", "alpha", "beta", "gamma", "phi", "theta", "psi", "matrix", "rotmat", *ANGLES),
    *ROTATION_VECTOR_WORDS,
)
"""Words of an orientation, of whichever convention."""

_UNITS = {
    **{unit: unit for unit in (*LENGTH_UNITS, *TIME_UNITS, *ANGLE_UNITS)},
    **dict.fromkeys(("meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millisec", "millisecs", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "microsec", "microsecs", "microseconds", "µs", "μs"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"), "ns"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
}
"""Spelling -> unit."""
_CLOCK_WORDS = [word for word, unit in _UNITS.items() if unit in TIME_UNITS and len(word) > 2]
"""Units of time that are the whole name of a column of times."""
_NO_UNIT = ("", "-", "1", "none", "unitless")
_BRACKETS = re.compile(r"(?:[\[(<]\s*(?!\d+\s*[\])>])|\s+[\[(<]\s*)([^\])>]*?)\s*[\])>]$")
_FRAMES = re.compile(r"^(p|q)_[A-Z]{1,2}(?:_[A-Z])?_([wxyz])$")
"""Position and quaternion with the frames in the name, as in the EuRoC data sets: p_RS_R_x, q_RS_w."""
_CAMEL_CASE = re.compile(r"(?<=[a-z])(?=[A-Z])")
_WORDS = re.compile(r"[a-zµμ°]+|\d+")


class ColumnName(NamedTuple):
    """The parts of a name, in lower case."""

    name: str
    """As in the file."""
    root: tuple[str, ...]
    """The words before ``word``: which of several poses."""
    word: str
    """The quantity; empty for an axis alone."""
    axis: str
    """x, y, z, w, roll, pitch or yaw; empty for none."""
    numbers: tuple[str, ...]
    """Numbers at the end, at most two."""
    unit: str
    """The unit as stated, in the spelling of this package where it is a known one; empty for none."""


def parse_name(name: str) -> ColumnName:
    """Splits the name of a column into its parts."""
    text = name.strip().strip("'\"").strip()
    unit, body = "", text
    bracket = _BRACKETS.search(text)
    if bracket:
        unit, body = bracket.group(1), text[: bracket.start()].strip()
    if frames := _FRAMES.match(body):
        return ColumnName(name, (), frames.group(1), frames.group(2), (), known_unit(unit))
    words = _WORDS.findall(_CAMEL_CASE.sub(" ", body).lower())
    if not bracket and len(words) > 1 and words[-1] in _UNITS:  # "time_ms", "x_mm"
        unit = words.pop()
    elif len(words) == 1 and words[0] in _CLOCK_WORDS:
        unit, words = words[0], ["stamp"]
    axis = ""
    numbers: list[str] = []
    while len(words) > 1 and words[-1].isdigit() and len(numbers) < 2:
        numbers.insert(0, words.pop())
    if not numbers and words and words[-1] in ANGLES:
        axis = words.pop()
    elif not numbers and words and words[-1][-1] in "wxyz":
        axis, words = words[-1][-1], [*words[:-1], *filter(None, [words[-1][:-1]])]
    word = words.pop() if words else ""
    if word in ("vec", "vector", "angle") and words and words[-1] + word in ROTATION_VECTOR_WORDS:
        word = words.pop() + word
    if word in ORDERS and words and words[-1] in QUATERNION_WORDS:
        words.pop()
    if axis in ANGLES and word and word not in ROTATION_LIKE:  # "goal_roll": the root ends before the angle
        words, word = [*words, word], ""
    return ColumnName(name, tuple(words), word, axis, tuple(numbers), known_unit(unit))


def known_unit(text: str) -> str:
    """A unit in the spelling of this package; as it is if unknown; empty for a number without unit."""
    lowered = text.strip().lower()
    return "" if lowered in _NO_UNIT else _UNITS.get(lowered, text.strip())


def is_unit(text: str) -> bool:
    """Whether a text, perhaps in brackets, is a unit of length, time or angle, or says that there is none."""
    return known_unit(text.strip().strip("[](){}<>")) in ("", *_UNITS)


def is_time(column: ColumnName) -> bool:
    """Whether the name is that of a time."""
    if column.axis or column.numbers:
        return False
    return column.word in TIME_WORDS or (not column.root and column.word in TIME_WORDS_ALONE)


def is_rotation_like(column: ColumnName) -> bool:
    """Whether the name may be that of a part of an orientation, in whichever convention."""
    if column.axis in ANGLES or column.word in ROTATION_LIKE:
        return True
    if column.axis == "w":
        return column.word in ("", *QUATERNION_WORDS)
    return column.word in ("r", "q") and bool(column.axis or column.numbers)

"""Tables of poses in text files and NPY files."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from ik_node.errors import TrajectoryFileError
from ik_node.math.types import Array
from ik_node.trajectory.column_names import is_unit
from ik_node.trajectory.pose_table import PoseTable, is_number, numbered

COMMENT = ("#", "%")
MATRIX_SHAPES = ((4, 4), (3, 4))


def text_table(path: Path, text: str) -> PoseTable:
    """The table of a text.

    Columns are separated by commas, semicolons, tabs or blanks; lines that begin with # or % are comments. The names
    are the first line if none of its fields is a number, else the last comment that has as many fields as there are
    columns. A line of units may follow the names.

    Args:
        path: The file, for messages.
        text: Its content.

    Raises:
        TrajectoryFileError: The text is no such table.
    """
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    comments = [line.lstrip("".join(COMMENT)).strip() for line in lines if line.startswith(COMMENT)]
    content = [line for line in lines if not line.startswith(COMMENT)]
    if not content:
        raise TrajectoryFileError(f"{path.name} holds no data")
    delimiter = next((mark for mark in ",;\t" if mark in content[-1]), " ")
    try:
        rows = _split(content, delimiter)
        header = rows.pop(0) if rows and _is_header(rows[0]) else None
        if header is not None and rows and _is_header(rows[0]) and all(map(is_unit, rows[0])):
            units = rows.pop(0)
            header = tuple(f"{name} [{unit.strip('[](){}')}]" for name, unit in zip(header, units, strict=False))
        width = len(rows[0]) if rows else 0
        if header is None:
            possible = [fields for line in reversed(comments) for fields in _comment_fields(line, delimiter)]
            header = next((fields for fields in possible if len(fields) == width), None)
    except csv.Error as error:  # a field of more than 128 KiB
        raise TrajectoryFileError(f"{path.name} is no table: {error}") from error
    if not rows:
        raise TrajectoryFileError(f"{path.name} holds {'no data' if header is None else 'a header and no data'}")
    for number, row in enumerate(rows):
        if len(row) != width:
            raise TrajectoryFileError(f"{path.name}: sample {number} has {len(row)} columns, the first has {width}")
    if header is not None and len(header) != width:
        raise TrajectoryFileError(f"{path.name}: the header names {len(header)} columns, the rows have {width}")
    names = numbered(width) if header is None else header
    return PoseTable(path, names, tuple(rows), header is not None, blanks=delimiter == " ")


def array_table(path: Path, demo: int | None) -> PoseTable:
    """The table of an NPY file; ``demo`` is the number of the demonstration, from 0.

    Arrays have the shape (samples, columns) or (samples, 4 or 3, 4), both perhaps below an axis of demonstrations.

    Raises:
        TrajectoryFileError: The file holds no such array.
        OSError: The file cannot be read.
    """
    try:
        array = np.load(path, allow_pickle=False)
    except OSError:
        raise
    # numpy parses the header as Python (TokenError, RecursionError) and reserves what it claims (MemoryError).
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise TrajectoryFileError(f"{path.name} is no NPY file of numbers: {reason}") from error
    if not isinstance(array, np.ndarray):  # an archive of arrays that is named .npy
        raise TrajectoryFileError(f"{path.name} is no NPY file of numbers: it is an archive")
    return table_of_array(path, array, demo)


def table_of_array(path: Path, array: Array, demo: int | None) -> PoseTable:
    """The table of an array; arguments, result and errors as for :func:`array_table`."""
    matrices = array.ndim in (3, 4) and array.shape[-2:] in MATRIX_SHAPES
    several = array.ndim == (4 if matrices else 3)
    if array.dtype.kind not in "fiu" or not (several or matrices or array.ndim == 2) or not array.size:
        raise TrajectoryFileError(
            f"{path.name} holds {array.dtype} of shape {array.shape}; expected numbers of shape (samples, columns), "
            "(samples, 4, 4) or (samples, 3, 4), or these with the number of demonstrations before"
        )
    note = ""
    if several:
        count, demo = len(array), demo or 0
        if not 0 <= demo < count:
            raise TrajectoryFileError(
                f"{path.name} holds {count} demonstrations; demo is {demo}, valid: 0 to {count - 1}"
            )
        array, note = array[demo], f"demonstration {demo} of {count}"
    elif demo is not None:
        raise one_demonstration(path, demo)
    rows = array.reshape(len(array), -1)
    return PoseTable(path, numbered(rows.shape[1]), rows, False, note, matrices=matrices)


def one_demonstration(path: Path, demo: int) -> TrajectoryFileError:
    """The error of a demonstration number for a file that has one demonstration."""
    return TrajectoryFileError(f"{path.name} holds one demonstration; --demo {demo} has no effect")


def _split(lines: list[str], delimiter: str) -> list[tuple[str, ...]]:
    if delimiter == " ":
        return [tuple(line.split()) for line in lines]
    reader = csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter, skipinitialspace=True)
    return [tuple(field.strip() for field in row) for row in reader if row]


def _comment_fields(comment: str, delimiter: str) -> list[tuple[str, ...]]:
    """The fields of a comment, separated as the data are, or by anything."""
    return [*_split([comment], delimiter), tuple(comment.replace(",", " ").replace(";", " ").split())]


def _is_header(fields: tuple[str, ...]) -> bool:
    return any(fields) and not any(is_number(field) for field in fields if field)

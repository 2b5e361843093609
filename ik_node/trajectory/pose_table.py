"""Reads columns of numbers from CSV, text and NPY files."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ik_node.errors import TrajectoryFileError
from ik_node.math.types import Array

COMMENT = ("#", "%")


@dataclass(frozen=True)
class PoseTable:
    """The rows of a file; a column is converted to numbers on access, so unused columns may contain any text."""

    path: Path
    names: tuple[str, ...]
    """Names from the header; "0", "1", ... without one."""
    rows: tuple[tuple[str, ...], ...] | Array
    """One entry per sample."""
    named: bool
    """True if the names are from the file."""
    note: str = ""
    """Note for the user; empty for none."""

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> Array:
        """The numbers of a column.

        Args:
            name: Name of the column, or its number from 0.

        Returns:
            Finite numbers (N,).

        Raises:
            TrajectoryFileError: There is no such column (the message lists the columns), or a row has no finite number.
        """
        index = self._index(name)
        if isinstance(self.rows, np.ndarray):
            values = np.array(self.rows[:, index], dtype=np.float64)
        else:
            values = np.array([self._number(row, index) for row in range(len(self.rows))])
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise TrajectoryFileError(
                f"{self.path.name}: column '{name}' is not finite in {bad.size} of {len(values)} rows, "
                f"first in sample {int(bad[0])}"
            )
        return values

    def _index(self, name: str) -> int:
        if name in self.names:
            return self.names.index(name)
        if name.isdecimal() and int(name) < len(self.names):
            return int(name)
        raise TrajectoryFileError(f"{self.path.name}: no column '{name}'; there are: {', '.join(self.names)}")

    def _number(self, row: int, index: int) -> float:
        text = self.rows[row][index]
        try:
            return float(text) if text else float("nan")
        except ValueError as error:
            where = f"sample {row}, column '{self.names[index]}'"
            raise TrajectoryFileError(f"{self.path.name}: {where} holds '{text}', not a number") from error


def read_table(path: Path, demo: int = 0) -> PoseTable:
    """Reads a table.

    NPY files have the shape (samples, columns) or (demonstrations, samples, columns). Text is separated by commas,
    semicolons, tabs or blanks; lines that begin with # or % are comments; the names are the first line if that is not
    numbers, else the last comment that has as many words as there are columns.

    Args:
        path: The file.
        demo: Number of the demonstration, from 0.

    Returns:
        The table.

    Raises:
        TrajectoryFileError: The file cannot be read as such a table.
    """
    try:
        if path.suffix.lower() == ".npy":
            return _read_npy(path, demo)
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        if isinstance(error, TrajectoryFileError):
            raise
        raise TrajectoryFileError(f"{path} cannot be read: {error}") from error
    if demo:
        raise TrajectoryFileError(f"{path.name} is text and holds one demonstration; demo is {demo}, valid: 0")
    return _read_text(path, text)


def _read_npy(path: Path, demo: int) -> PoseTable:
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
    if array.dtype.kind not in "fiu" or array.ndim not in (2, 3):
        raise TrajectoryFileError(
            f"{path.name} holds {array.dtype} of shape {array.shape}; expected numbers of shape (samples, columns) or "
            "(demonstrations, samples, columns)"
        )
    count = len(array) if array.ndim == 3 else 1
    if not 0 <= demo < count:
        raise TrajectoryFileError(f"{path.name} holds {count} demonstrations; demo is {demo}, valid: 0 to {count - 1}")
    rows = array[demo] if array.ndim == 3 else array
    note = f"demonstration {demo} of {count}" if array.ndim == 3 else ""
    return PoseTable(path, _numbered(rows.shape[1]), rows, False, note)


def _read_text(path: Path, text: str) -> PoseTable:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    comments = [line.lstrip("".join(COMMENT)).strip() for line in lines if line.startswith(COMMENT)]
    content = [line for line in lines if not line.startswith(COMMENT)]
    if not content:
        raise TrajectoryFileError(f"{path.name} holds no data")
    delimiter = next((mark for mark in ",;\t" if mark in content[-1]), " ")
    try:
        rows = _split(content, delimiter)
    except csv.Error as error:  # a field of more than 128 KiB
        raise TrajectoryFileError(f"{path.name} is no table: {error}") from error
    if not rows:
        raise TrajectoryFileError(f"{path.name} holds no data")
    header = None if _are_numbers(rows[0]) else rows.pop(0)
    if not rows:
        raise TrajectoryFileError(f"{path.name} holds a header and no data")
    width = len(rows[0])
    for number, row in enumerate(rows):
        if len(row) != width:
            raise TrajectoryFileError(f"{path.name}: sample {number} has {len(row)} columns, the first has {width}")
    if header is None:
        header = next((words for words in map(_words, reversed(comments)) if len(words) == width), None)
    elif len(header) != width:
        raise TrajectoryFileError(f"{path.name}: the header names {len(header)} columns, the rows have {width}")
    names = _numbered(width) if header is None else header
    return PoseTable(path, names, tuple(rows), header is not None)


def _split(lines: list[str], delimiter: str) -> list[tuple[str, ...]]:
    if delimiter == " ":
        return [tuple(line.split()) for line in lines]
    reader = csv.reader(io.StringIO("\n".join(lines)), delimiter=delimiter, skipinitialspace=True)
    return [tuple(field.strip() for field in row) for row in reader if row]


def _words(comment: str) -> tuple[str, ...]:
    return tuple(comment.replace(",", " ").replace(";", " ").split())


def _are_numbers(fields: tuple[str, ...]) -> bool:
    for field in fields:
        try:
            float(field or "nan")
        except ValueError:
            return False
    return True


def _numbered(count: int) -> tuple[str, ...]:
    return tuple(str(index) for index in range(count))

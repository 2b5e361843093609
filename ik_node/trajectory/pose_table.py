"""Columns of a file of poses, as text or numbers, before their meaning is known."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import TrajectoryFileError
from ik_node.math.types import Array

Cell = str | int | float


@dataclass(frozen=True)
class PoseTable:
    """The rows of a file; a column is converted to numbers on access, so unused columns may contain any text."""

    path: Path
    names: tuple[str, ...]
    """Names from the header; "0", "1", ... without one."""
    rows: tuple[tuple[Cell, ...], ...] | Array
    """One entry per sample."""
    named: bool
    """True if the names are from the file."""
    note: str = ""
    """Note for the user; empty for none."""
    blanks: bool = False
    """True if blanks separate the columns of a text file."""
    matrices: bool = False
    """True if the columns without names are the entries of one matrix per sample, row by row."""

    def __len__(self) -> int:
        return len(self.rows)

    def name_of(self, column: str) -> str:
        """The name of a column that is given by its name, or its number from 0."""
        return self.names[self._index(column)]

    def is_text(self, column: str) -> bool:
        """True if the first sample of a column is no number."""
        cell = self.rows[0][self._index(column)]
        return isinstance(cell, str) and not is_number(cell)

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

    def block(self, names: tuple[str, ...]) -> Array:
        """Several columns as numbers (N, len(names)); raises TrajectoryFileError as :meth:`column` does."""
        return np.column_stack([self.column(name) for name in names])

    def nanoseconds(self, name: str, unit_ns: int) -> NDArray[np.int64]:
        """A column of times in ns (N,), without the rounding of floating-point numbers where the file has text.

        Args:
            name: Name of the column, or its number from 0.
            unit_ns: Its unit, ns.

        Raises:
            TrajectoryFileError: As :meth:`column`, or a time does not fit into 64 bits.
        """
        values = self.column(name)
        if float(np.abs(values).max()) * unit_ns >= 2.0**63:
            raise TrajectoryFileError(f"{self.path.name}: the time in column '{name}' is out of range")
        index = self._index(name)
        if isinstance(self.rows, np.ndarray):
            whole: NDArray[np.int64] = np.floor(self.rows[:, index]).astype(np.int64)
            rest = np.where(np.floor(values) == values, 0.0, values - np.floor(values))
            return whole * unit_ns + np.round(rest * unit_ns).astype(np.int64)
        return np.array([int((Decimal(str(row[index])) * unit_ns).to_integral_value()) for row in self.rows], np.int64)

    def _index(self, name: str) -> int:
        if name in self.names:
            return self.names.index(name)
        if name.isdecimal() and int(name) < len(self.names):
            return int(name)
        raise TrajectoryFileError(f"{self.path.name}: no column '{name}'; there are: {', '.join(self.names)}")

    def _number(self, row: int, index: int) -> float:
        cell = self.rows[row][index]
        try:
            return float(cell) if cell != "" else float("nan")
        except (ValueError, OverflowError) as error:
            where = f"sample {row}, column '{self.names[index]}'"
            raise TrajectoryFileError(f"{self.path.name}: {where} holds '{str(cell)[:40]}', not a number") from error


def numbered(count: int) -> tuple[str, ...]:
    """Names of columns without a header: "0", "1", ..."""
    return tuple(str(index) for index in range(count))


def is_number(text: str) -> bool:
    """Whether a text is a number, or empty."""
    try:
        float(text or "nan")
    except ValueError:
        return False
    return True

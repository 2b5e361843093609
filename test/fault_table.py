"""The table fault x method that the tests of test/faults print."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Row(NamedTuple):
    """One line of the table."""

    fault: str
    case: str
    method: str
    over: str
    """Largest command / velocity limit in force."""
    not_finite: str
    """Number of commands that are not finite."""
    acceleration: str
    """Largest acceleration of the command / its limit, without zeros at once."""
    zero: str
    """Time from the fault to zero velocity, or to the expected status of an arm in closed loop, s."""
    status: str
    back: str
    wrong: str
    """What is not as it has to be; empty when all is right."""


HEAD = Row("fault", "case", "method", "v/limit", "nan", "a/limit", "zero after", "status", "way back", "wrong")
WIDTHS = Row("42", "6", "17", "7", "3", "7", "14", "66", "26", "200")


def table(rows: Iterable[Sequence[str]]) -> str:
    """The rows as text."""
    lines = []
    for row in (HEAD, *rows):
        cells = [str(cell).replace("\n", " ") for cell in row]
        lines.append(
            "  ".join(f"{cell[: int(width)]:{width}}" for cell, width in zip(cells, WIDTHS, strict=True)).rstrip()
        )
    return "\n".join(lines)


def failures(rows: Iterable[Row]) -> list[str]:
    """Names of the cells that are wrong, with what is wrong."""
    return [f"{row.fault} x {row.method}: {row.wrong}" for row in rows if row.wrong]

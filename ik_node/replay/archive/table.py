"""The rows of an archive as text, CSV, JSON and Parquet."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ik_node.errors import MissingPackageError
from ik_node.replay.archive.row import BagRow

MAX_NAME, MAX_VERDICT = 36, 96
"""Of a line on the terminal, in characters."""
_COLUMNS = (
    ("bag", "<"),
    ("robot", "<"),
    ("method", "<"),
    ("version", "<"),
    ("RMS [mm]", ">"),
    ("max [mm]", ">"),
    ("slowed [s]", ">"),
    ("worst limit", "<"),
    ("replay", "<"),
    ("verdict", "<"),
)


def flat(row: BagRow) -> dict[str, Any]:
    """A row with one key per column; the what-if runs as ``<metric> [<run>]``."""
    plain = row._asdict()
    what_if = plain.pop("what_if")
    return plain | {f"{metric} [{name}]": value for name, run in what_if.items() for metric, value in run.items()}


def columns_of(rows: Sequence[BagRow]) -> tuple[str, ...]:
    """The columns of all rows, in order of first appearance."""
    return tuple(dict.fromkeys(column for row in rows for column in flat(row)))


def as_text(rows: Sequence[BagRow]) -> str:
    """One line per recording, below it its what-if runs, and at the end the number of recordings by result."""
    cells = [tuple(name for name, _ in _COLUMNS), *map(_cells, rows)]
    widths = [max(len(line[index]) for line in cells) for index in range(len(_COLUMNS))]

    def line(values: Sequence[str]) -> str:
        padded = (f"{value:{side}{width}}" for value, (_, side), width in zip(values, _COLUMNS, widths, strict=True))
        return "  ".join(padded).rstrip()

    lines = [line(cells[0])]
    for row, values in zip(rows, cells[1:], strict=True):
        lines.append(line(values))
        lines += [
            f"    what if {name}: {_number(run['position_rms_mm'], 3)} mm RMS; in the recording "
            f"{_number(row.position_rms_mm, 3)}"
            for name, run in row.what_if.items()
        ]
    results = ", ".join(f"{number} {result}" for result, number in Counter(row.replay for row in rows).most_common())
    lines.append(f"{len(rows)} recording{'s' if len(rows) != 1 else ''}: {results}")
    return "\n".join(lines)


def _cells(row: BagRow) -> tuple[str, ...]:
    name = row.bag if len(row.bag) <= MAX_NAME else "..." + row.bag[3 - MAX_NAME :]
    text = row.verdict or row.error
    if row.error and row.verdict:
        text = f"{row.verdict} Not replayed: {row.error}"
    return (
        name,
        row.robot,
        row.method,
        row.version.partition(" ")[0],
        _number(row.position_rms_mm, 3),
        _number(row.position_max_mm, 2),
        _number(row.slowed_s, 2),
        row.worst_limit,
        row.replay,
        text if len(text) <= MAX_VERDICT else text[: MAX_VERDICT - 3] + "...",
    )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def as_csv(rows: Sequence[BagRow]) -> str:
    """One line per recording; what is not known is empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, columns_of(rows), lineterminator="\n")
    writer.writeheader()
    writer.writerows(map(flat, rows))
    return text.getvalue()


def as_json(rows: Sequence[BagRow]) -> str:
    """A list of objects with the fields of :class:`~ik_node.replay.archive.row.BagRow`."""
    return json.dumps([row._asdict() for row in rows], indent=1, allow_nan=False)


def write_parquet(rows: Sequence[BagRow], path: Path) -> None:
    """Writes the flat rows; raises MissingPackageError when pyarrow is not installed."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise MissingPackageError(error) from error
    columns = columns_of(rows)
    numbers = {name for name in columns if any(isinstance(flat(row).get(name), (int, float)) for row in rows)}
    schema = pa.schema([(name, pa.float64() if name in numbers or "[" in name else pa.string()) for name in columns])
    lines = [flat(row) for row in rows]
    arrays = [
        pa.array([_typed(line.get(name), name in numbers) for line in lines], schema.field(name).type)
        for name in columns
    ]
    parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), path)


def _typed(value: Any, number: bool) -> Any:
    return float(value) if number and value is not None else value

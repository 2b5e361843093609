"""Tables of poses in JSON: one object per line, a list of objects, an object of columns, or lists of numbers.

Nested objects and lists become columns whose names are joined by dots: ``{"pose": {"position": {"x": 1}}}`` is the
column ``pose.position.x``, ``{"p": [1, 2, 3]}`` are ``p.0``, ``p.1`` and ``p.2``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.errors import TrajectoryFileError
from ik_node.trajectory.pose_table import Cell, PoseTable
from ik_node.trajectory.pose_text import table_of_array


def json_table(path: Path, text: str, demo: int | None) -> PoseTable:
    """The table of a JSON document or of JSON lines.

    Args:
        path: The file, for messages.
        text: Its content.
        demo: Number of the demonstration, from 0, for lists of numbers.

    Raises:
        TrajectoryFileError: The text is not JSON, or has no samples of equal structure.
    """
    records = _records(path, text)
    if not all(isinstance(record, dict) for record in records):
        try:
            return table_of_array(path, np.array(records), demo)
        except ValueError as error:
            if isinstance(error, TrajectoryFileError):
                raise
            raise TrajectoryFileError(f"{path.name} holds lists of different lengths: {error}") from error
    rows: list[tuple[Cell, ...]] = []
    names: tuple[str, ...] = ()
    for number, record in enumerate(records):
        flat: dict[str, Cell] = {}
        _flatten(record, "", flat)
        names = names or tuple(flat)
        different = set(names) ^ set(flat)
        if different:
            name = min(different)
            which = "has no" if name in names else "alone has a"
            raise TrajectoryFileError(f"{path.name}: sample {number} {which} '{name}'")
        rows.append(tuple(flat[name] for name in names))
    return PoseTable(path, names, tuple(rows), True)


def _records(path: Path, text: str) -> list[Any]:
    try:
        try:
            content = json.loads(text)
        except json.JSONDecodeError:
            content = [_line(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    except (ValueError, RecursionError) as error:
        raise TrajectoryFileError(f"{path.name} is no JSON: {' '.join(str(error).split())}") from error
    if isinstance(content, dict):
        content = _records_of_object(path, content)
    if not isinstance(content, list) or not content:
        raise TrajectoryFileError(f"{path.name} holds no samples")
    return content


def _records_of_object(path: Path, content: dict[str, Any]) -> list[Any]:
    """The only list of an object, the records of several lists of one length (columns), or the object itself."""
    lists = {key: value for key, value in content.items() if isinstance(value, list) and len(value) > 1}
    if len(lists) == 1:
        only = next(iter(lists.values()))
        return only if _is_record(only[0]) else [content]
    lengths = {key: len(value) for key, value in lists.items()}
    if len(set(lengths.values())) > 1:
        said = ", ".join(f"'{key}' {length}" for key, length in lengths.items())
        raise TrajectoryFileError(f"{path.name} holds lists of different lengths: {said}")
    return [dict(zip(lists, values, strict=True)) for values in zip(*lists.values(), strict=True)] or [content]


def _line(number: int, line: str) -> Any:
    try:
        return json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"line {number}: {error.msg}") from error


def _is_record(value: Any) -> bool:
    return isinstance(value, dict | list)


def _flatten(value: Any, name: str, flat: dict[str, Cell]) -> None:
    if _is_record(value):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            _flatten(below, f"{name}.{key}" if name else str(key), flat)
    elif isinstance(value, str | int | float) and not isinstance(value, bool):
        flat[name] = value
    else:
        flat[name] = "" if value is None else str(value)

"""Command-line options for reading a file of poses, made from the fields of PoseFileFormat."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

from ik_node.errors import TrajectoryFileError
from ik_node.trajectory.pose_file_format import PoseFileFormat, flag


def add_options(group: argparse._ArgumentGroup, *, motion: bool = True) -> None:
    """Add an option per field to ``group``: ``--units``, ``--order`` and so on.

    Args:
        group: The group.
        motion: Also the options that change the motion, beside those that say how the file is read.
    """
    for field in _fields(motion):
        kind: dict[str, Any] = {}
        if field.type == "bool":
            kind = {"action": "store_true"}
        elif isinstance(field.default, tuple):
            numbers = bool(field.default)
            kind = {"nargs": "+", "type": float if numbers else str, "metavar": "M" if numbers else "COLUMN"}
        else:
            kind = {"type": {"int": int, "str": str}.get(str(field.type).split(" ")[0], float), "metavar": "VALUE"}
        if field.metadata["choices"]:
            kind |= {"choices": field.metadata["choices"], "metavar": None}
        group.add_argument(flag(field.name), dest=field.name, help=field.metadata["description"], **kind)


def format_from(options: argparse.Namespace, *, motion: bool = True) -> PoseFileFormat:
    """Return the format described by the options; raises TrajectoryFileError when they contradict each other."""
    given: dict[str, Any] = {}
    for field in _fields(motion):
        value = getattr(options, field.name)
        if value is not None:
            given[field.name] = tuple(value) if isinstance(value, list) else value
    return PoseFileFormat(**given)


def refuse_given(file_format: PoseFileFormat, reason: str) -> None:
    """Raise TrajectoryFileError, with ``reason``, when a format has been given where no file is read with it."""
    if given := file_format.given():
        raise TrajectoryFileError(f"{', '.join(map(flag, given))}: no effect, {reason}")


def _fields(motion: bool) -> list[dataclasses.Field[Any]]:
    return [field for field in dataclasses.fields(PoseFileFormat) if motion or not field.metadata["motion"]]

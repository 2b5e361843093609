"""Command-line options for reading a file of poses, made from the fields of PoseFileFormat."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

from ik_node.trajectory.pose_file_format import PoseFileFormat


def add_options(group: argparse._ArgumentGroup) -> None:
    """Add an option per field to ``group``: ``--units``, ``--order`` and so on."""
    for field in dataclasses.fields(PoseFileFormat):
        kind: dict[str, Any] = {}
        if field.type == "bool":
            kind = {"action": "store_true"}
        elif isinstance(field.default, tuple):
            numbers = bool(field.default)
            kind = {"nargs": "+", "type": float if numbers else str, "metavar": "M" if numbers else "COLUMN"}
        else:
            kind = {"type": {"int": int, "str": str}.get(str(field.type), float), "metavar": "VALUE"}
        if field.metadata["choices"]:
            kind |= {"choices": field.metadata["choices"], "metavar": None}
        group.add_argument(_flag(field.name), dest=field.name, help=field.metadata["description"], **kind)


def format_from(options: argparse.Namespace) -> PoseFileFormat:
    """Return the format described by the options; raises TrajectoryFileError when they contradict each other."""
    given: dict[str, Any] = {}
    for field in dataclasses.fields(PoseFileFormat):
        value = getattr(options, field.name)
        if value is not None:
            given[field.name] = tuple(value) if isinstance(value, list) else value
    return PoseFileFormat(**given)


def _flag(name: str) -> str:
    return "--" + name.removesuffix("_s").replace("_", "-")

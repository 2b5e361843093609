"""Export of a run as CSV or JSON, one row per control step.

Columns of a Step's fields are named ``field.component_unit``, for example ``pose_sb.x_m`` or ``twist_b.rz_rad_s``, and
follow the declaration in :mod:`ik_node.interfaces.step`.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.errors import RecordingError
from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, Kind, StepField
from ik_node.math.types import Array
from ik_node.recording.run import Run


def columns(run: Run) -> dict[str, list[Any]]:
    """The columns of the table.

    Args:
        run: A recorded run.

    Returns:
        Column name -> one value per control step; None where nothing was computed.
    """
    table: dict[str, list[Any]] = {
        "tick": run.tick.tolist(),
        "time_s": run.times_s.tolist(),
        "ros_time_ns": run.ros_ns.tolist(),
        "state_time_s": _plain(run.state_times_s),
        "mode": [status.mode.value for status in run.status],
        "level": [status.level.name.lower() for status in run.status],
        "reason": [status.reason for status in run.status],
        "binding": ["; ".join(names) for names in run.binding],
        "off_direction_limits": ["; ".join(names) for names in run.off_direction_limits],
        "closest_pair": ["; ".join(names) for names in run.closest_pair],
    }
    for field in (*ARRAY_FIELDS, *NUMBER_FIELDS):
        values = run.columns[field.name]
        if field.kind is Kind.POSE:
            values = np.hstack((values[:, :3, 3], _quaternions(values)))
        names = _component_names(field, run.joints)
        for name, column in zip(names, values.reshape(len(values), len(names)).T, strict=True):
            table[name] = _plain(column)
    return table


def write_csv(run: Run, path: Path) -> None:
    """Writes the table with a header line; raises RecordingError when ``path`` exists or cannot be written."""
    table = columns(run)
    try:
        with path.open("x", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(table)
            writer.writerows(zip(*table.values(), strict=True))
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise RecordingError(f"'{path}' cannot be written: {getattr(error, 'strerror', None) or error}") from error


def write_json(run: Run, path: Path) -> None:
    """Writes run information and columns; raises RecordingError when ``path`` exists or cannot be written."""
    document = {
        "robot": run.robot,
        "joints": list(run.joints),
        "base_frame": run.base_frame,
        "tip_frame": run.tip_frame,
        "settings": dict(run.settings),
        "versions": dict(run.versions),
        "dropped": run.dropped,
        "complete": run.complete,
        "columns": columns(run),
    }
    try:
        with path.open("x", encoding="utf-8") as file:
            json.dump(document, file, allow_nan=False)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise RecordingError(f"'{path}' cannot be written: {getattr(error, 'strerror', None) or error}") from error


def _component_names(field: StepField, joints: tuple[str, ...]) -> list[str]:
    """Column names of a field, with units."""
    linear, _, angular = field.quantity.unit.partition(", ")
    axes = [f"{axis}{_suffix(linear)}" for axis in "xyz"]
    count = field.shape(len(joints))
    components = {
        Kind.JOINTS: [f"{joint}{_suffix(linear)}" for joint in joints],
        Kind.POSE: [*axes, "qx", "qy", "qz", "qw"],
        Kind.TWIST: [*axes, *(f"r{axis}{_suffix(angular)}" for axis in "xyz")],
        Kind.POINT_PAIR: [f"{point}_{axis}" for point in ("first", "second") for axis in axes],
    }
    if field.kind is Kind.NUMBER:
        return [f"{field.name}{_suffix(linear)}"]
    names = components.get(field.kind) or [f"{index + 1}{_suffix(linear)}" for index in range(count[0])]
    return [f"{field.name}.{name}" for name in names]


def _suffix(unit: str) -> str:
    """A unit as the end of a column name: ``rad/s (m/s)`` -> ``_rad_s_m_s``."""
    plain = unit.replace("(", "").replace(")", "").replace("/", "_").replace(" ", "_")
    return f"_{plain}" if plain else ""


def _quaternions(poses: Array) -> Array:
    """x, y, z, w of poses (k, 4, 4); NaN where the pose is."""
    # Imported here because it loads numba, which reading a recording does not need.
    from ik_node.math.se3 import quaternion_from_rotation

    result = np.full((len(poses), 4), np.nan)
    for index in np.flatnonzero(np.isfinite(poses[:, 0, 0])).tolist():
        result[index] = quaternion_from_rotation(poses[index, :3, :3])
    return result


def _plain(values: Array) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]

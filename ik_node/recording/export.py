"""A run as a table, for spreadsheets and other people's programs: CSV or JSON, one row per tick."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.errors import RecordingError
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.recording.run import Run

_AXES = ("x", "y", "z")
_ERROR = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
_WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
_QUATERNION = ("qx", "qy", "qz", "qw")


def columns(run: Run) -> dict[str, list[Any]]:
    """Name of a column (with its unit) -> values, one per tick; None where a tick computed nothing."""
    table: dict[str, list[Any]] = {
        "tick": run.tick.tolist(),
        "time_s": run.times_s.tolist(),
        "ros_time_ns": run.ros_ns.tolist(),
        "state_time_s": _plain(run.state_times_s),
        "mode": [status.mode.value for status in run.status],
        "level": [status.level.name.lower() for status in run.status],
        "reason": [status.reason for status in run.status],
        "binding": ["; ".join(names) for names in run.binding],
    }
    for name, values in _arrays(run):
        table[name] = _plain(values)
    return table


def write_csv(run: Run, path: Path) -> None:
    """One row per tick, the names of the columns first; RecordingError where ``path`` exists or cannot be written."""
    table = columns(run)
    try:
        with path.open("x", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(table)
            writer.writerows(zip(*table.values(), strict=True))
    except OSError as error:
        raise RecordingError(f"'{path}' cannot be written: {error.strerror}") from error


def write_json(run: Run, path: Path) -> None:
    """What the run is about, and the columns; RecordingError where ``path`` exists or cannot be written."""
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
    except OSError as error:
        raise RecordingError(f"'{path}' cannot be written: {error.strerror}") from error


def _arrays(run: Run) -> Iterator[tuple[str, Array]]:
    for name, values, unit in (("q", run.q, "rad_m"), ("command", run.joint_velocity, "rad_s_m_s")):
        for index, joint in enumerate(run.joints):
            yield f"{name}.{joint}_{unit}", values[:, index]
    for name, poses in (("tool", run.pose_sb), ("target", run.pose_sd)):
        yield from _split(name, poses[:, :3, 3], [f"{axis}_m" for axis in _AXES])
        yield from _split(name, _quaternions(poses), _QUATERNION)
    for name, twists in (
        ("error_b", run.error_b),
        ("feedforward_b", run.feedforward_b),
        ("twist_b", run.twist_b),
        ("lost_b", run.lost_b),
    ):
        yield from _split(name, twists, _ERROR if name == "error_b" else _TWIST)
    for name, wrenches in (
        ("multiplier_task", run.multiplier_task),
        ("multiplier_potential", run.multiplier_potential),
    ):
        yield from _split(name, wrenches, _WRENCH)
    for name, numbers in (
        ("scale", run.scale),
        ("progress", run.progress),
        ("path_distance_m", run.path_distance),
        ("clearance_m", run.clearance),
    ):
        yield name, numbers
    for index in range(run.singular_values.shape[1]):
        yield f"singular_value_{index + 1}_m", run.singular_values[:, index]


def _split(name: str, values: Array, parts: Any) -> Iterator[tuple[str, Array]]:
    for index, part in enumerate(parts):
        yield f"{name}.{part}", values[:, index]


def _quaternions(poses: Array) -> Array:
    result = np.full((len(poses), 4), np.nan)
    for index in np.flatnonzero(np.isfinite(poses[:, 0, 0])).tolist():
        result[index] = quaternion_from_rotation(poses[index, :3, :3])
    return result


def _plain(values: Array) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]

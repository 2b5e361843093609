"""Target poses, paths, trajectories and twists: CDR bytes -> plain data. Values are not validated; the controller does
that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import MAX_POSES, PathSample, PoseSample, TrajectorySample, TwistSample
from ik_node.math.types import Array
from ik_node.messages.cdr import Cursor, reading

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
PATH_TYPE = "nav_msgs/msg/Path"
TRAJECTORY_TYPE = "trajectory_msgs/msg/MultiDOFJointTrajectory"
TWIST_TYPE = "geometry_msgs/msg/TwistStamped"
MAX_PATH_BYTES = 1_000_000
"""Size of a path or trajectory: 2000 poses with frames of 400 bytes, or 2000 points with twists and accelerations."""
MAX_NAMES = 16
"""Joint names of a trajectory; one is needed and none is used."""
SIZES = {"transforms": 7, "velocities": 6, "accelerations": 6}
"""Sequences of a trajectory point, and the numbers of their elements."""
MAX_SINGLE_BYTES = 4_096
"""Size of one pose or twist: its numbers take 64 bytes, the rest is the name of its frame."""


def decode_pose(data: bytes) -> PoseSample:
    """Decodes a geometry_msgs/PoseStamped; raises InputError for other bytes."""
    with reading(data, POSE_TYPE) as cursor:
        cursor.check_size(MAX_SINGLE_BYTES)
        stamp_ns = cursor.stamp()
        frame_id = cursor.string()
        numbers = cursor.floats(7)
    return PoseSample(stamp_ns, frame_id, numbers[:3], numbers[3:])


def decode_path(data: bytes) -> PathSample:
    """Decodes a path.

    Args:
        data: CDR bytes of a nav_msgs/Path; a pose without a frame gets that of the path.

    Raises:
        InputError: The bytes are no such message, or it has more than :data:`MAX_POSES` poses; their number is read
            before the poses are.
    """
    with reading(data, PATH_TYPE) as cursor:
        stamp_ns = cursor.stamp()
        own = cursor.string()
        count = cursor.bounded_count(MAX_POSES, "poses")
        cursor.check_size(MAX_PATH_BYTES)
        frames: list[str] = []
        stamps: list[int] = []
        numbers: list[Array] = []
        for _ in range(count):
            stamps.append(cursor.stamp())
            frames.append(cursor.string() or own)
            numbers.append(cursor.floats(7))
    poses = _rows(numbers, 7)
    return PathSample(tuple(frames), tuple(stamps), poses[:, :3].copy(), poses[:, 3:].copy(), stamp_ns)


def decode_trajectory(data: bytes) -> TrajectorySample:
    """Decodes a trajectory of the tool.

    Args:
        data: CDR bytes of a trajectory_msgs/MultiDOFJointTrajectory with one joint of any name, the tool.

    Raises:
        InputError: The bytes are no such message, it has more than :data:`MAX_POSES` points, a point does not have
            exactly one transform, or only some points have a velocity (or an acceleration); points are numbered from 0.
    """
    with reading(data, TRAJECTORY_TYPE) as cursor:
        stamp_ns = cursor.stamp()
        frame_id = cursor.string()
        for _ in range(cursor.bounded_count(MAX_NAMES, "joint names")):
            cursor.string()
        count = cursor.bounded_count(MAX_POSES, "points")
        cursor.check_size(MAX_PATH_BYTES)
        parts: list[NDArray[Any]] = []
        sizes = [0, 0, 0]
        if count:
            sizes = _point_sizes(Cursor(data, cursor.offset), 0)
            parts = [cursor.records(sizes, 1), cursor.records(sizes, count - 1)]
            _check_points(cursor, parts, sizes, count)
    numbers, twists, accelerations = (
        np.concatenate([np.empty((0, size)), *(part[f"numbers_{index}"] for part in parts if sizes[index])])
        for index, size in enumerate(SIZES.values())
    )
    times = [
        int(s) * NS + int(ns) for part in parts for s, ns in zip(part["seconds"], part["nanoseconds"], strict=True)
    ]
    positions, quaternions = numbers[:, :3].copy(), numbers[:, 3:].copy()
    return TrajectorySample(stamp_ns, frame_id, tuple(times), positions, quaternions, twists, accelerations)


def decode_twist(data: bytes) -> TwistSample:
    """Decodes a geometry_msgs/TwistStamped; raises InputError for other bytes."""
    with reading(data, TWIST_TYPE) as cursor:
        cursor.check_size(MAX_SINGLE_BYTES)
        return TwistSample(cursor.stamp(), cursor.string(), cursor.floats(6))


def _point_sizes(cursor: Cursor, number: int, first: Sequence[int] = ()) -> list[int]:
    """Numbers in transform, velocity and acceleration of a point; InputError if they are not those of the first."""
    sizes = []
    for index, (name, size) in enumerate(SIZES.items()):
        length = cursor.count()
        expected = first[index] // size if first else 1 if index == 0 else min(length, 1)
        if length != expected:
            end = ", as in point 0" if index else ""
            raise InputError(f"point {number} has {length} {name}; expected {expected}{end}")
        sizes.append(size * length)
        cursor.floats(sizes[-1])
    return sizes


def _check_points(cursor: Cursor, parts: Sequence[NDArray[Any]], sizes: Sequence[int], count: int) -> None:
    """Raises an error for the first point that is incomplete, or has other contents than point 0."""
    expected = [size // one for size, one in zip(sizes, SIZES.values(), strict=True)]
    first, others = parts
    differs = np.any([others[f"length_{index}"] != length for index, length in enumerate(expected)], axis=0)
    right = int(np.argmax(differs)) if differs.any() else len(others)
    if len(first) and right < count - 1:
        cursor.offset += (right - len(others)) * others.itemsize
        _point_sizes(cursor, right + 1, sizes)
    if len(first) + right < count:
        raise ValueError("a point exceeds the message")


def _rows(rows: list[Array], width: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, width)

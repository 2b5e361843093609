"""Target poses, paths, trajectories and twists: CDR bytes -> plain data. Values are not validated; the controller does
that."""

from __future__ import annotations

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.samples import MAX_POSES, PathSample, PoseSample, TrajectorySample, TwistSample
from ik_node.math.types import Array
from ik_node.messages.cdr import reading

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
PATH_TYPE = "nav_msgs/msg/Path"
TRAJECTORY_TYPE = "trajectory_msgs/msg/MultiDOFJointTrajectory"
TWIST_TYPE = "geometry_msgs/msg/TwistStamped"
MAX_PATH_BYTES = 1_000_000
"""Size of a path or trajectory: 2000 poses with frames of 400 bytes, or 2000 points with twists and accelerations."""
MAX_NAMES = 16
"""Joint names of a trajectory; one is needed and none is used."""
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
        times: list[int] = []
        poses: list[Array] = []
        derivatives: dict[str, list[Array]] = {"velocities": [], "accelerations": []}
        count = cursor.bounded_count(MAX_POSES, "points")
        cursor.check_size(MAX_PATH_BYTES)
        for number in range(count):
            if (transforms := cursor.count()) != 1:
                raise InputError(f"point {number} has {transforms} transforms; expected 1")
            poses.append(cursor.floats(7))
            for name, rows in derivatives.items():
                found, before = cursor.count(), len(rows)
                if found > 1 or (number and found != before // number):
                    expected = min(before // number, 1) if number else min(found, 1)
                    raise InputError(f"point {number} has {found} {name}; expected {expected}, as in point 0")
                rows.extend(cursor.floats(6) for _ in range(found))
            times.append(cursor.stamp())
    numbers = _rows(poses, 7)
    twists, accelerations = (_rows(rows, 6) for rows in derivatives.values())
    positions, quaternions = numbers[:, :3].copy(), numbers[:, 3:].copy()
    return TrajectorySample(stamp_ns, frame_id, tuple(times), positions, quaternions, twists, accelerations)


def decode_twist(data: bytes) -> TwistSample:
    """Decodes a geometry_msgs/TwistStamped; raises InputError for other bytes."""
    with reading(data, TWIST_TYPE) as cursor:
        cursor.check_size(MAX_SINGLE_BYTES)
        return TwistSample(cursor.stamp(), cursor.string(), cursor.floats(6))


def _rows(rows: list[Array], width: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, width)

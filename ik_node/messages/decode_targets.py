"""Target poses, paths, trajectories and twists: CDR bytes -> plain data. Values are not validated; the controller does
that."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import PathSample, PoseSample, TrajectorySample, TwistSample
from ik_node.math.types import Array
from ik_node.messages.cdr import LITTLE_ENDIAN, Cursor, deserialize, stamp_of

POSE_TYPE = "geometry_msgs/msg/PoseStamped"
PATH_TYPE = "nav_msgs/msg/Path"
TRAJECTORY_TYPE = "trajectory_msgs/msg/MultiDOFJointTrajectory"
TWIST_TYPE = "geometry_msgs/msg/TwistStamped"


def decode_pose(data: bytes) -> PoseSample:
    """Decodes a geometry_msgs/PoseStamped; raises InputError for other bytes."""
    if data[:2] != LITTLE_ENDIAN:
        message = deserialize(data, POSE_TYPE)
        p, q = message.pose.position, message.pose.orientation
        position, quaternion = np.array([p.x, p.y, p.z]), np.array([q.x, q.y, q.z, q.w])
        return PoseSample(stamp_of(message), message.header.frame_id, position, quaternion)
    try:
        cursor = Cursor(data)
        stamp_ns = cursor.stamp()
        frame_id = cursor.string()
        numbers = cursor.floats(7)
    except (struct.error, ValueError) as error:
        raise InputError(f"bytes are no {POSE_TYPE}: {error}") from error
    return PoseSample(stamp_ns, frame_id, numbers[:3], numbers[3:])


def decode_path(data: bytes) -> PathSample:
    """Decodes a nav_msgs/Path; a pose without a frame gets that of the path. Raises InputError for other bytes."""
    message = deserialize(data, PATH_TYPE)
    poses, own = message.poses, str(message.header.frame_id)
    return PathSample(
        tuple(str(stamped.header.frame_id) or own for stamped in poses),
        tuple(stamp_of(stamped) for stamped in poses),
        _rows([_xyz(stamped.pose.position) for stamped in poses], 3),
        _rows([_xyzw(stamped.pose.orientation) for stamped in poses], 4),
    )


def decode_trajectory(data: bytes) -> TrajectorySample:
    """Decodes a trajectory of the tool.

    Args:
        data: CDR bytes of a trajectory_msgs/MultiDOFJointTrajectory with one joint of any name, the tool.

    Raises:
        InputError: The bytes are no such message, a point does not have exactly one transform, or only some points have
            a velocity (or an acceleration); points are numbered from 0.
    """
    message = deserialize(data, TRAJECTORY_TYPE)
    points = message.points
    for number, point in enumerate(points):
        if len(point.transforms) != 1:
            raise InputError(f"point {number} has {len(point.transforms)} transforms; expected 1")
        for name in ("velocities", "accelerations"):
            count, first = len(getattr(point, name)), len(getattr(points[0], name))
            if count > 1 or count != first:
                raise InputError(f"point {number} has {count} {name}; expected {min(first, 1)}, as in point 0")
    return TrajectorySample(
        stamp_of(message),
        str(message.header.frame_id),
        tuple(int(point.time_from_start.sec) * NS + int(point.time_from_start.nanosec) for point in points),
        _rows([_xyz(point.transforms[0].translation) for point in points], 3),
        _rows([_xyzw(point.transforms[0].rotation) for point in points], 4),
        _rows([_twist(twist) for point in points for twist in point.velocities], 6),
        _rows([_twist(twist) for point in points for twist in point.accelerations], 6),
    )


def decode_twist(data: bytes) -> TwistSample:
    """Decodes a geometry_msgs/TwistStamped; raises InputError for other bytes."""
    message = deserialize(data, TWIST_TYPE)
    return TwistSample(stamp_of(message), str(message.header.frame_id), np.array(_twist(message.twist)))


def _rows(rows: list[tuple[float, ...]], width: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _xyz(p: Any) -> tuple[float, ...]:
    return (p.x, p.y, p.z)


def _xyzw(q: Any) -> tuple[float, ...]:
    return (q.x, q.y, q.z, q.w)


def _twist(twist: Any) -> tuple[float, ...]:
    return (*_xyz(twist.linear), *_xyz(twist.angular))

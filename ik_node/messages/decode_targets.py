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
    """The geometry_msgs/PoseStamped in ``data``; InputError when it is none."""
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
    """The nav_msgs/Path in ``data``. A pose that names no frame is in the path's. InputError when it is none."""
    message = deserialize(data, PATH_TYPE)
    poses, own = message.poses, str(message.header.frame_id)
    return PathSample(
        tuple(str(stamped.header.frame_id) or own for stamped in poses),
        tuple(stamp_of(stamped) for stamped in poses),
        _rows([_xyz(stamped.pose.position) for stamped in poses], 3),
        _rows([_xyzw(stamped.pose.orientation) for stamped in poses], 4),
    )


def decode_trajectory(data: bytes) -> TrajectorySample:
    """The trajectory_msgs/MultiDOFJointTrajectory in ``data``: one joint, the tool; its name does not matter.

    InputError when it is none, when a point has not one transform, or when only some points have a velocity (or an
    acceleration); the message names the point by its number from 0.
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
    """The geometry_msgs/TwistStamped in ``data``; InputError when it is none."""
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

"""Tables of poses in ROS bags: rosbag2 (MCAP, sqlite3) and rosbag1."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ik_node.errors import TrajectoryFileError
from ik_node.trajectory.pose_columns import GOAL_WORDS
from ik_node.trajectory.pose_table import Cell, PoseTable

SUFFIXES = (".bag", ".mcap", ".db3")
POSE_TYPES = {
    "geometry_msgs/msg/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/TransformStamped": ("transform.translation", "transform.rotation"),
    "nav_msgs/msg/Odometry": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PointStamped": ("point", ""),
    "geometry_msgs/msg/Pose": ("position", "orientation"),
    "geometry_msgs/msg/Transform": ("translation", "rotation"),
    "geometry_msgs/msg/Point": ("", ""),
}
"""Message type -> fields of position and orientation."""
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSITION, QUATERNION = ("x", "y", "z"), ("qx", "qy", "qz", "qw")
STAMP, RECEIVED = "stamp_ns", "received_ns"


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag: a folder, or a file with its suffix."""
    return path.is_dir() or path.suffix.lower() in SUFFIXES


def bag_table(path: Path, topic: str = "") -> PoseTable:
    """The poses of one topic.

    Args:
        path: Folder or file of the bag.
        topic: Name of the topic; for transforms followed by a colon and the child frame. Empty: the only topic of
            poses, or the only one whose name has one of :data:`~ik_node.trajectory.pose_columns.GOAL_WORDS`.

    Returns:
        Columns of position, quaternion, and the time of the header (if no header lacks it) and of the recording.

    Raises:
        TrajectoryFileError: The topic is none of the bag, or there are several; the message lists them.
        RecordingError: The bag cannot be read.
    """
    from ik_node.recording.bag_reader import BagReader  # needs rosbags, which is an extra

    reader = BagReader(path)
    types = {found.name: found.type_name for found, count in reader.counts.items() if count}
    poses = [name for name, kind in types.items() if kind in POSE_TYPES]
    transforms = [name for name, kind in types.items() if kind == TRANSFORMS]
    chosen = topic.partition(":")[0] if topic.partition(":")[0] in transforms else topic or _only(path, poses)
    wanted = [chosen] if chosen else transforms
    if not wanted or not set(wanted) <= {*poses, *transforms}:
        listed = ", ".join(f"{name} ({kind})" for name, kind in types.items()) or "nothing"
        what = f"topic of poses '{topic}'" if topic else "topic of poses"
        raise TrajectoryFileError(f"{path.name} has no {what}; it holds: {listed}")
    found = _rows(reader, wanted, types)
    moving = [name for name, messages in found.items() if len(messages) > 1 and name.startswith(topic)]
    name = topic if topic in found else _only(path, moving)
    if name not in found:
        raise TrajectoryFileError(f"{path.name} has no poses of '{topic or TRANSFORMS}'; it has: {', '.join(found)}")
    return _table(path, name, found[name])


def _only(path: Path, names: list[str]) -> str:
    """The only name, or the only one of a goal; empty for none."""
    goals = [name for name in names if any(word in name.lower() for word in GOAL_WORDS)]
    if len(names) > 1 and len(goals) != 1:
        raise TrajectoryFileError(f"{path.name} has several topics of poses; give --topic: {', '.join(sorted(names))}")
    return next(iter(goals if len(names) > 1 else names), "")


def _rows(reader: Any, wanted: list[str], types: dict[str, str]) -> dict[str, list[tuple[Any, int, str]]]:
    """Name -> message, time of the recording in ns, and type of every pose."""
    from ik_node.messages.cdr import STORE

    found: dict[str, list[tuple[Any, int, str]]] = {}
    for name, received_ns, data in reader.messages(wanted):
        try:
            message: Any = STORE.deserialize_cdr(data, types[name])
        except Exception as error:  # whatever rosbags raises for the bytes of a message
            raise TrajectoryFileError(f"{reader.path.name}: a message of {name} is damaged: {error}") from error
        if types[name] == TRANSFORMS:
            for transform in message.transforms:
                key = f"{name}:{transform.child_frame_id}"
                found.setdefault(key, []).append((transform, received_ns, "geometry_msgs/msg/TransformStamped"))
        else:
            found.setdefault(name, []).append((message, received_ns, types[name]))
    return found


def _table(path: Path, name: str, messages: list[tuple[Any, int, str]]) -> PoseTable:
    stamps = [_stamp_ns(message) for message, _, _ in messages]
    frames = {message.header.frame_id for message, _, _ in messages if hasattr(message, "header")}
    if len(frames) > 1:
        raise TrajectoryFileError(
            f"{path.name}: the poses of {name} are in several frames: {', '.join(sorted(frames))}"
        )
    place, turn = POSE_TYPES[messages[0][2]]
    rows: list[tuple[Cell, ...]] = []
    for (message, received_ns, _), stamp_ns in zip(messages, stamps, strict=True):
        position = _field(message, place)
        quaternion = [getattr(_field(message, turn), axis) for axis in "xyzw"] if turn else []
        rows.append((stamp_ns, received_ns, position.x, position.y, position.z, *quaternion))
    names = (STAMP, RECEIVED, *POSITION, *(QUATERNION if turn else ()))
    if not all(stamps):
        names, rows = names[1:], [row[1:] for row in rows]
    frame = f" in frame '{frames.pop()}'" if frames else ""
    return PoseTable(path, names, tuple(rows), True, f"topic {name}{frame}")


def _stamp_ns(message: Any) -> int:
    """The stamp of the header in ns; 0 without."""
    if not hasattr(message, "header"):
        return 0
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _field(message: Any, path: str) -> Any:
    for name in filter(None, path.split(".")):
        message = getattr(message, name)
    return message

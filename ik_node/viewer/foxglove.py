"""A recording with transforms and markers, for viewers that have no model of the arm: Foxglove, RViz, PlotJuggler.

Added to the messages of inputs and outputs, whose names and bytes stay:

=================== ====================================== ============================================================
``/tf_static``      tf2_msgs/TFMessage, latched            links that are fixed to the base
``/tf``             tf2_msgs/TFMessage                     all other links, from the measured joint positions
``<node>/arm``      visualization_msgs/MarkerArray,        visual geometry as TRIANGLE_LIST, fixed to the links
                    latched
``<node>/markers``  visualization_msgs/MarkerArray         tool path, target, obstacles, clearance, as published by the
                                                           node
=================== ====================================== ============================================================

The parent of each link is the base frame. The records of calls and Steps, which only this package reads, are left out.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS, Instant
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages.cdr import header, make, serialize
from ik_node.messages.decode_obstacles import MARKERS_TYPE
from ik_node.messages.markers import TRIANGLE_LIST, SceneMarkers, marker
from ik_node.recording.call_log import RecordedCalls
from ik_node.recording.input_table import JOINT_STATES
from ik_node.recording.mcap.metadata import Qos
from ik_node.recording.mcap.reader import RecordedMessage
from ik_node.recording.mcap.writer import Recorder, RecorderOptions
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.recording.run_recorder import (
    CALL_TEXTS,
    CALLS,
    ROBOT_DESCRIPTION,
    SETUP,
    SNAPSHOT,
    STEP,
    STEP_TEXTS,
)
from ik_node.report.clearances import settings_of
from ik_node.report.recorded_scene import SceneAt, read_obstacles, scene_history
from ik_node.robot.reduced_model import frame_id
from ik_node.robot.robot import Robot
from ik_node.viewer.layouts import write_layouts
from ik_node.viewer.meshes import MeshPart
from ik_node.viewer.open_run import first_scene, load_meshes
from ik_node.viewer.timeline import Timeline, timeline_of

TF, TF_STATIC, TF_TYPE = "/tf", "/tf_static", "tf2_msgs/msg/TFMessage"
ARM, MARKERS = "arm", "markers"
TF_PERIOD_S, MARKERS_PERIOD_S = 0.02, 0.1
MESSAGES_PER_WRITE = 1000
_LATCHED = Qos(depth=1, latched=True)
_PRIVATE = (SETUP, CALLS, CALL_TEXTS, SNAPSHOT, STEP, STEP_TEXTS)
"""Records that only this package reads."""


class _Message(NamedTuple):
    log_time_ns: int
    topic: str
    type_name: str
    data: bytes
    publish_time_ns: int = 0


def write_foxglove(path: Path, out: Path, templates: Path, node: str = "") -> tuple[str, ...]:
    """Writes a recording with transforms and markers, and layouts beside it.

    Args:
        path: Recording of a run.
        out: New folder.
        templates: Folder of the layouts, ``config/`` of the package.
        node: Full name of the node; default: the only recorded one.

    Returns:
        What is missing in it, one sentence each.

    Raises:
        RecordingError: The recording cannot be read, or ``out`` exists or cannot be written.
        RobotError: The robot model of the run is invalid.
        MissingPackageError: trimesh is not installed.
    """
    run, calls = load_run(path, node), RecordedCalls(path, node)
    name, inputs = calls.head.node, calls.head.setup["inputs"]
    settings = settings_of(run)
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, settings.arm.joint_prefix)
    parts, notes = load_meshes(robot, settings.obstacles.package_path)
    recorded = read_obstacles(path, node)
    first, scene_notes = (recorded.first, ()) if recorded.first else first_scene(robot, settings.obstacles.scene)
    timeline = timeline_of(run)
    scene_at = scene_history(robot, first, recorded.arrivals, lambda time_s: run.q[timeline.row(time_s)])
    links = LinkFrames(robot)
    start_ns = int(run.ros_ns[0])
    private = {f"{name}/{topic}" for topic in _PRIVATE}
    sources = (
        (_copy(message) for message in calls.recording.messages() if message.topic not in private),
        (
            _Message(start_ns, TF_STATIC, TF_TYPE, links.fixed(start_ns)),
            _Message(start_ns, f"{name}/{ARM}", MARKERS_TYPE, arm_markers(parts, links, start_ns)),
        ),
        (
            _Message(run.ros_ns[row], TF, TF_TYPE, links.moving(run.q[row], int(run.state_ros_ns[row])))
            for row in _rows(run, TF_PERIOD_S)
        ),
        _scene_markers(run, timeline, f"{name}/{MARKERS}", scene_at),
    )
    _write(
        heapq.merge(*sources, key=lambda message: message.log_time_ns),
        out,
        (TF_STATIC, f"{name}/{ARM}", ROBOT_DESCRIPTION),
    )
    topics = {"/ik_node/": f"{name}/", "/joint_states": inputs[JOINT_STATES]}
    # The meshes of the URDF are package:// names, which only a ROS installation resolves.
    drawn = {f"{name}/{ARM}": True, f"{name}/{MARKERS}": True, ROBOT_DESCRIPTION: False}
    write_layouts(templates, out, topics, run.joints, run.base_frame, drawn)
    missing = (f"obstacle messages of the run are left out: {recorded.missing}",) if recorded.missing else ()
    return (*notes, *scene_notes, *missing)


def _write(messages: Iterable[_Message], out: Path, latched: tuple[str, ...]) -> None:
    """Writes messages, in order of time, into a new recording."""
    writer = Recorder(out, RecorderOptions(own_thread=False))
    channels: dict[str, int] = {}
    for count, message in enumerate(messages):
        if message.topic not in channels:
            qos = _LATCHED if message.topic in latched else None
            channels[message.topic] = writer.channel(message.topic, message.type_name, qos)
        writer.write(channels[message.topic], message.data, message.log_time_ns, message.publish_time_ns)
        if count % MESSAGES_PER_WRITE == 0:
            writer.write_pending()
    writer.close()
    if writer.error or writer.dropped:
        raise RecordingError(writer.error or f"'{out}': {writer.dropped} messages are larger than the queue")


def _copy(message: RecordedMessage) -> _Message:
    return _Message(message.log_time_ns, message.topic, message.type_name, message.data, message.publish_time_ns)


class LinkFrames:
    """Poses of the links in the base frame, as transforms."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        frames = robot.model.frames
        bodies = [frame for frame in frames if frame.type == pin.FrameType.BODY and frame.name != robot.base_frame]
        self._fixed = [frame.name for frame in bodies if frame.parentJoint == 0]
        self._moving = [frame.name for frame in bodies if frame.parentJoint != 0]
        self.of_joint = {0: robot.base_frame}
        """Joint of the model -> a link that is fixed to it."""
        for frame in bodies:
            self.of_joint.setdefault(int(frame.parentJoint), frame.name)

    def fixed(self, stamp_ns: int) -> bytes:
        """The links that do not move, as tf2_msgs/TFMessage."""
        return self._message(self._fixed, np.zeros(self._robot.n), stamp_ns)

    def moving(self, q: Array, stamp_ns: int) -> bytes:
        """The other links at joint positions q, (n,), rad (m)."""
        return self._message(self._moving, q, stamp_ns)

    def joint_in_link(self, joint: int) -> Array:
        """Pose of a joint's frame in the link :attr:`of_joint`, (4, 4)."""
        robot, link = self._robot, self.of_joint[joint]
        if joint == 0:
            return robot.pose_base_root
        placement = robot.model.frames[frame_id(robot.model, link)].placement
        return np.asarray(placement.inverse().homogeneous)

    def _message(self, links: list[str], q: Array, stamp_ns: int) -> bytes:
        transforms = []
        for link in links:
            pose = self._robot.frame_pose(q, link)
            x, y, z = pose[:3, 3].tolist()
            qx, qy, qz, qw = se3.quaternion_from_rotation(pose[:3, :3]).tolist()
            transform = make(
                "geometry_msgs/msg/Transform",
                translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
            )
            stamped = header(self._robot.base_frame, stamp_ns)
            transforms.append(
                make("geometry_msgs/msg/TransformStamped", header=stamped, child_frame_id=link, transform=transform)
            )
        return serialize(make(TF_TYPE, transforms=transforms))


def arm_markers(parts: Iterable[MeshPart], links: LinkFrames, stamp_ns: int) -> bytes:
    """The visual geometry as visualization_msgs/MarkerArray; each marker moves with its link."""
    markers = []
    for number, part in enumerate(parts):
        pose = links.joint_in_link(part.parent)
        corners = (part.vertices @ pose[:3, :3].T + pose[:3, 3])[part.faces].reshape(-1, 3)
        link, colour = links.of_joint[part.parent], (*part.colour, 1.0)
        markers.append(
            marker(link, ARM, number, TRIANGLE_LIST, stamp_ns, points=corners, colour=colour, frame_locked=True)
        )
    return serialize(make(MARKERS_TYPE, markers=markers))


def _scene_markers(run: Run, timeline: Timeline, topic: str, scene_at: SceneAt) -> Iterator[_Message]:
    markers, row = SceneMarkers(run.base_frame), 0
    for last in _rows(run, MARKERS_PERIOD_S):
        for step in range(row, last + 1):
            frame: Any = timeline.frame(step)  # has the fields of Step
            markers.add_step(frame)
        row = last + 1
        time_s = float(run.times_s[last])
        now = Instant(round(time_s * NS), int(run.ros_ns[last]))
        yield _Message(now.ros_ns, topic, MARKERS_TYPE, markers.encode_markers(scene_at(time_s), now))


def _rows(run: Run, period_s: float) -> list[int]:
    """Rows of the run with finite joint positions, ``period_s`` apart."""
    rows, due_s = [], -np.inf
    for row in np.flatnonzero(np.isfinite(run.q).all(axis=1)).tolist():
        if run.times_s[row] >= due_s:
            rows.append(row)
            due_s = run.times_s[row] + period_s
    return rows

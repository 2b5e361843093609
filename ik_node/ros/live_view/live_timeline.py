"""Timeline of a running node, assembled from its topics."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, Level, Mode, Status
from ik_node.math import se3
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.messages import cdr, encode
from ik_node.messages.decode import decode_joint_state
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.messages.decode_targets import decode_pose
from ik_node.report.recorded_scene import ClosestPointQuery, SceneHistory
from ik_node.robot.robot import Robot
from ik_node.ros.live_view.listener import LiveViewListener
from ik_node.settings.groups import Settings
from ik_node.viewer.open_run import first_scene
from ik_node.viewer.timeline import TimelineBuffer, TimelineFrame

MAX_TARGETS = 2000
STALE_S = 1.0
"""The status becomes STALE without a joint state for this long."""


class LiveTimeline:
    """Frames of a running node, one per call of :meth:`sample`."""

    def __init__(self, node: LiveViewListener, robot: Robot, settings: Settings, capacity: int) -> None:
        """Creates an empty timeline.

        Args:
            node: Source of the messages.
            robot: The robot of the running node.
            settings: The settings of the running node.
            capacity: Number of frames that are kept at least.
        """
        self._node = node
        self.robot = robot
        self._row_scale = np.repeat((1.0, settings.control.characteristic_length), 3)
        self.buffer = TimelineBuffer(robot.n, capacity)
        self.scenes = SceneHistory(robot, first_scene(robot, settings.obstacles.scene)[0])
        self._closest_points = ClosestPointQuery(robot, settings.obstacles)
        self.targets: deque[Array] = deque(maxlen=MAX_TARGETS)
        self._tasks = [(-math.inf, TaskTolerance(settings.task.tolerance, settings.task.frame))]
        """Tolerances of the node, each with the time from which on it applies, s."""
        self._q = np.full(robot.n, np.nan)
        self._q_time_s = -math.inf

    @property
    def has_joint_state(self) -> bool:
        """Whether all joint positions are known."""
        return bool(np.isfinite(self._q).all())

    def tolerance_at(self, time_s: float) -> TaskTolerance:
        """The tolerance of the node's task at a time, s."""
        return next(task for begin_s, task in reversed(self._tasks) if begin_s <= time_s)

    def sample(self, time_s: float) -> None:
        """Appends the frame of the current time ``time_s``."""
        node, n = self._node, self.robot.n
        if node.task != self._tasks[-1][1]:
            self._tasks.append((time_s, node.task))
        # Copied at once, so that all messages are of the same or of neighbouring control steps.
        latest = dict(node.latest)
        self._read_joint_state(node.latest.pop("joint_states", None), time_s)
        self._read_queue(time_s)
        columns = {field.name: field.not_computed(n) for field in (*ARRAY_FIELDS, *NUMBER_FIELDS)}
        columns |= {
            "joint_position": self._q,
            "joint_velocity": _decoded(latest.get(encode.JOINT_VELOCITY), _velocity, (n,)),
            "pose_sd": _decoded(latest.get(encode.DESIRED_POSE), _pose, (4, 4)),
            "error_b": _decoded(latest.get(encode.TWIST_ERROR), _twist, (6,)),
            "multiplier_task": _decoded(latest.get(encode.MULTIPLIER_TASK), _wrench, (6,)),
            "multiplier_potential": _decoded(latest.get(encode.MULTIPLIER_POTENTIAL), _wrench, (6,)),
            "scale": _number(node.diagnostic_values.get("scale")),
        }
        if self.has_joint_state:
            kinematics = self.robot.evaluate(self._q)
            columns["pose_sb"] = kinematics.pose_sb
            columns["singular_values"] = np.linalg.svd(
                kinematics.jacobian_b * self._row_scale[:, None], compute_uv=False
            )
        # The node publishes its clearance once per second only, and without the closest points.
        closest = self._closest_points.closest(self._q, self.scenes(time_s))
        if closest is not None:
            columns["clearance"], columns["closest_points"] = closest.distance, closest.points_s
        texts = {
            **{name: _names(node.diagnostic_values, name) for name in ("binding", "off_direction_limits")},
            "closest_pair": () if closest is None else closest.names,
            "status": self._status(time_s),
        }
        self.buffer.append(TimelineFrame(time_s, columns, texts))

    def _read_joint_state(self, data: bytes | None, time_s: float) -> None:
        if data is None:
            return
        try:
            sample = decode_joint_state(data)
        except InputError:  # the running node rejects it too and reports it in its status
            return
        indices = {name: index for index, name in enumerate(sample.names)}
        if all(name in indices and indices[name] < len(sample.position) for name in self.robot.joints):
            self._q = np.array([sample.position[indices[name]] for name in self.robot.joints])
            self._q_time_s = time_s

    def _read_queue(self, time_s: float) -> None:
        queue = self._node.queue
        while queue:
            topic, data = queue.popleft()
            try:
                if topic == "obstacles":
                    q = np.where(np.isfinite(self._q), self._q, 0.0)
                    self.scenes.add((time_s, decode_obstacles(data)), q)
                else:
                    sample = decode_pose(data)
                    if sample.frame_id in ("", self.robot.base_frame):
                        self.targets.append(sample.position)
            except InputError:  # the running node rejects it too and reports it in its status
                continue

    def _status(self, time_s: float) -> Status:
        message = self._node.status
        if message is None:
            return Status(Level.STALE, Mode.WAITING, f"no status from {self._node.watched} yet")
        if time_s - self._q_time_s > STALE_S:
            return Status(Level.STALE, Mode.WAITING, f"no joint states; last status of the node: {message.message}")
        mode = next((entry.value for entry in message.values if entry.key == "mode"), Mode.WAITING.value)
        return Status(Level(int.from_bytes(message.level, "little")), Mode(mode), message.message)


def _decoded(data: bytes | None, decode: Callable[[bytes], Array], shape: tuple[int, ...]) -> Array:
    """The array in a message; NaN without a message, or if it has another shape."""
    if data is not None:
        try:
            values = decode(data)
        except InputError:
            values = np.zeros(0)
        if values.shape == shape:
            return values
    return np.full(shape, np.nan)


def _velocity(data: bytes) -> Array:
    return np.array(cdr.deserialize(data, encode.TYPES[encode.JOINT_VELOCITY]).velocity, dtype=np.float64)


def _pose(data: bytes) -> Array:
    sample = decode_pose(data)
    return se3.pose_from(sample.position, sample.quaternion)


def _twist(data: bytes) -> Array:
    twist = cdr.deserialize(data, encode.TYPES[encode.TWIST_ERROR]).twist
    return np.array([twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z])


def _wrench(data: bytes) -> Array:
    wrench = cdr.deserialize(data, encode.TYPES[encode.MULTIPLIER_TASK]).wrench
    force, torque = wrench.force, wrench.torque
    return np.array([force.x, force.y, force.z, torque.x, torque.y, torque.z])


def _names(values: Mapping[str, str], key: str) -> tuple[str, ...]:
    return tuple(filter(None, values.get(key, "").split(", ")))


def _number(text: str | None) -> float:
    try:
        return float(text) if text else math.nan
    except ValueError:
        return math.nan

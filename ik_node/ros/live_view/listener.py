"""Subscriptions to everything that a running node publishes; messages are kept as bytes."""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from ik_node.errors import IkNodeError, SettingsError
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.messages import encode
from ik_node.robot.srdf import with_srdf_text
from ik_node.ros import qos
from ik_node.settings.groups import Settings

NEWEST = QoSProfile(depth=1, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Only the newest message is needed."""

PAUSE_S = 0.02
"""Between parameter requests, which limits the load of the running node."""
REQUESTED = (
    "rate_hz",
    "method",
    "robot",
    "robot_description",
    "base_frame",
    "tip_frame",
    "joints",
    "joint_prefix",
    "characteristic_length",
    "task.tolerance",
    "task.frame",
    "limits.velocity",
    "limits.velocity_fraction",
    "obstacles.scene",
    "obstacles.geometry",
    "obstacles.package_path",
    "obstacles.srdf",
    "obstacles.self_collision",
    "obstacles.ignored_pairs",
    "obstacles.watched_pairs",
)
"""Parameters that the page needs."""

_STREAMS = {
    encode.JOINT_VELOCITY: JointState,
    encode.DESIRED_POSE: PoseStamped,
    encode.TWIST_ERROR: TwistStamped,
    encode.MULTIPLIER_TASK: WrenchStamped,
    encode.MULTIPLIER_POTENTIAL: WrenchStamped,
}


class LiveViewListener(Node):  # type: ignore[misc]
    """Keeps the newest bytes of every topic; they are decoded when a frame is sampled."""

    def __init__(self, watched: str, context: Any = None) -> None:
        """Creates the subscriptions.

        Args:
            watched: Full name of the running node.
            context: Of rclpy; None for the default context.
        """
        super().__init__(f"ik_view_{os.getpid()}", context=context)
        self.watched = watched
        self.robot_description = ""
        self.latest: dict[str, bytes] = {}
        self.queue: deque[tuple[str, bytes]] = deque(maxlen=10000)
        """Topic and bytes of every target and obstacle message, in order of arrival."""
        self.status: DiagnosticStatus | None = None
        self.diagnostic_values: dict[str, str] = {}
        """Key -> value of the node's newest diagnostics."""
        self.task = TaskTolerance()
        """Which part of the pose the node follows; that of its parameters, and of their changes."""
        self.create_subscription(ParameterEvent, "/parameter_events", self._on_parameters, qos.OUTPUT)
        self.create_subscription(String, "robot_description", self._on_description, qos.LATCHED)
        self.create_subscription(DiagnosticStatus, f"{watched}/status", self._on_status, qos.LATCHED)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.OUTPUT)
        self._keep_newest(JointState, "joint_states", "joint_states")
        for topic, kind in _STREAMS.items():
            self._keep_newest(kind, f"{watched}/{topic}", topic)
        self._keep_all(PoseStamped, "target_pose")
        self._keep_all(MarkerArray, "obstacles")

    def _keep_newest(self, kind: type, topic: str, key: str) -> None:
        def on_bytes(data: bytes) -> None:
            self.latest[key] = data

        self.create_subscription(kind, topic, on_bytes, NEWEST, raw=True)

    def _keep_all(self, kind: type, topic: str) -> None:
        def on_bytes(data: bytes) -> None:
            self.queue.append((topic, data))

        self.create_subscription(kind, f"{self.watched}/{topic}", on_bytes, qos.STREAM, raw=True)

    def _on_parameters(self, event: ParameterEvent) -> None:
        if event.node != self.watched:
            return
        changed = {one.name: parameter_value_to_python(one.value) for one in event.changed_parameters}
        self.task = TaskTolerance(
            changed.get("task.tolerance", self.task.half_widths), changed.get("task.frame", self.task.frame)
        )

    def _on_description(self, message: String) -> None:
        self.robot_description = message.data

    def _on_status(self, message: DiagnosticStatus) -> None:
        self.status = message
        self._store_values(message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self.watched:
                self._store_values(status)

    def _store_values(self, status: DiagnosticStatus) -> None:
        self.diagnostic_values = {entry.key: entry.value for entry in status.values}

    def request_settings(self, timeout_s: float) -> Settings:
        """Requests the parameters that the page needs.

        Args:
            timeout_s: Time to wait for the service and for each answer.

        Returns:
            Settings with these parameters; all others have their defaults.

        Raises:
            IkNodeError: The node does not answer (the message lists the nodes that exist), or it is no ik_node.
        """
        client = self.create_client(GetParameters, f"{self.watched}/get_parameters")
        if not client.wait_for_service(timeout_s):
            named = self.get_node_names_and_namespaces()
            others = sorted(f"{space.rstrip('/')}/{name}" for name, space in named if name != self.get_name())
            raise IkNodeError(f"no node '{self.watched}' answers; nodes here: {', '.join(others) or 'none'}")
        # One by one: the answer to several names is empty if one of them is undeclared or unset.
        received = {}
        for name in REQUESTED:
            time.sleep(PAUSE_S)
            values = self._call(client, GetParameters.Request(names=[name]), timeout_s).values
            if len(values):
                received[name] = parameter_value_to_python(values[0])
        if "rate_hz" not in received:
            raise IkNodeError(f"node '{self.watched}' is no ik_node: it has no parameter rate_hz")
        settings = Settings().with_values(
            {name: _plain(value) for name, value in received.items() if value is not None}
        )
        self.task = TaskTolerance(settings.task.tolerance, settings.task.frame)
        try:
            return with_srdf_text(settings)
        except SettingsError as error:  # the running node may be on another machine
            self.get_logger().warning(f"link pairs are selected by sampling: {error}")
            return settings.with_values({"obstacles.srdf": ""})

    def _call(self, client: Any, request: Any, timeout_s: float) -> Any:
        future, deadline_s = client.call_async(request), time.monotonic() + timeout_s
        while not future.done():
            if time.monotonic() > deadline_s:
                raise IkNodeError(f"node '{self.watched}' does not answer requests for its parameters")
            time.sleep(0.001)
        return future.result()


def _plain(value: Any) -> Any:
    return value if isinstance(value, (str, bool, int, float)) else tuple(value)

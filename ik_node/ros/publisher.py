"""Publishes a Step on the topics of the node, the command first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rclpy.duration import Duration
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import MarkerArray

from ik_node.collision.scene import Scene
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Status, Step
from ik_node.messages import encode, step_outputs
from ik_node.messages.encode import Outgoing
from ik_node.messages.markers import SceneMarkers
from ik_node.messages.step_outputs import STEP_TOPICS, StepOutputs
from ik_node.robot.robot import Robot
from ik_node.ros import qos
from ik_node.settings.groups import Settings

MESSAGE_TYPES = {
    encode.COMMANDS: Float64MultiArray,
    encode.JOINT_VELOCITY: JointState,
    encode.CURRENT_POSE: PoseStamped,
    encode.DESIRED_POSE: PoseStamped,
    encode.TWIST_ERROR: TwistStamped,
    encode.MULTIPLIER_TASK: WrenchStamped,
    encode.MULTIPLIER_POTENTIAL: WrenchStamped,
    encode.STATUS: DiagnosticStatus,
    encode.DIAGNOSTICS: DiagnosticArray,
}
ACK_TIMEOUT = Duration(seconds=0.2)
"""Longest wait for subscribers to acknowledge a final message."""
SPECIAL_QOS = {encode.COMMANDS: qos.COMMAND, encode.STATUS: qos.LATCHED}


class StepPublisher:
    """Publishes bytes made by :mod:`ik_node.messages`; a recording stores the same bytes."""

    def __init__(self, node: Any) -> None:
        self._name = node.get_fully_qualified_name()
        self._publishers = {
            topic: node.create_publisher(
                kind, topic if topic.startswith("/") else f"~/{topic}", SPECIAL_QOS.get(topic, qos.OUTPUT)
            )
            for topic, kind in MESSAGE_TYPES.items()
        }
        self.topics = {topic: publisher.topic_name for topic, publisher in self._publishers.items()}
        # Markers are not recorded: they follow from recorded data, and are only made while there is a subscriber.
        self._marker_publisher = node.create_publisher(MarkerArray, "~/markers", qos.OUTPUT)
        self._markers: SceneMarkers | None = None
        self._outputs: StepOutputs | None = None
        self._method = ""
        self._last: Step | None = None
        self._last_status: Status | None = None
        self._joint_count = 0

    def configure(self, robot: Robot, settings: Settings) -> None:
        """Prepare the messages for Steps of ``robot``."""
        self._outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)
        self._markers = SceneMarkers(robot.base_frame)
        self._method = settings.control.method
        self._joint_count = robot.n

    @property
    def command_subscribers(self) -> int:
        """Number of subscriptions to the commands."""
        return int(self._publishers[encode.COMMANDS].get_subscription_count())

    def publish_step(self, step: Step, is_recorded: bool) -> list[Outgoing]:
        """Publish ``step`` on the topics with a subscriber, on all if it ``is_recorded``; return the messages.

        The command is published first, and always.
        """
        if self._outputs is None:
            return []
        command = Outgoing(encode.COMMANDS, self._outputs.command(step))
        self._publishers[encode.COMMANDS].publish(command.data)
        self._last = step
        topics = STEP_TOPICS if is_recorded else [topic for topic in STEP_TOPICS if self._has_subscriber(topic)]
        others = self._outputs.others(step, topics)
        for topic, data in others:
            self._publishers[topic].publish(data)
        if self._markers is not None:
            self._markers.add_step(step)
        return [command, *others]

    def publish_zero(self) -> None:
        """Publish a final zero command and wait until it is acknowledged.

        Without the wait a process that ends at once can lose the message.
        """
        self._publishers[encode.COMMANDS].publish(encode.encode_command(np.zeros(self._joint_count)))
        self._publishers[encode.COMMANDS].wait_for_all_acked(ACK_TIMEOUT)

    def publish_status(self, status: Status) -> Outgoing | None:
        """Publish ``status`` if it has changed; return the message, or None."""
        if status == self._last_status:
            return None
        self._last_status = status
        message = Outgoing(encode.STATUS, encode.encode_status(status, self._name, self._values()))
        self._publishers[encode.STATUS].publish(message.data)
        return message

    def publish_diagnostics(self, status: Status, now: Instant, values: Mapping[str, str]) -> Outgoing:
        """Publish /diagnostics with ``values`` and those of the last Step; return the message."""
        data = encode.encode_diagnostics([(status, self._name, {**self._values(), **values})], now.ros_ns)
        self._publishers[encode.DIAGNOSTICS].publish(data)
        return Outgoing(encode.DIAGNOSTICS, data)

    def publish_markers(self, scene: Scene, now: Instant) -> None:
        """Publish the markers if there is a subscriber; the next ones include the tool path in between."""
        if self._markers is not None and self._marker_publisher.get_subscription_count():
            self._marker_publisher.publish(self._markers.encode_markers(scene, now))

    def delete_markers(self, now: Instant) -> None:
        """Delete the markers of subscribers and wait until they acknowledge it."""
        if self._markers is not None and self._marker_publisher.get_subscription_count():
            self._marker_publisher.publish(self._markers.delete_all(now))
            self._marker_publisher.wait_for_all_acked(ACK_TIMEOUT)

    def _has_subscriber(self, topic: str) -> bool:
        return bool(self._publishers[topic].get_subscription_count())

    def _values(self) -> dict[str, str]:
        return {} if self._last is None else step_outputs.step_values(self._last, self._method)

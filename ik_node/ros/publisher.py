"""A Step on the node's topics, the command first."""

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
from ik_node.messages import encode
from ik_node.messages.encode import Outgoing, StepOutputs
from ik_node.messages.markers import SceneMarkers
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
LAST_WORD = Duration(seconds=0.2)
"""Longest wait until those who listen have the last there is to say."""
SPECIAL_QOS = {encode.COMMANDS: qos.COMMAND, encode.STATUS: qos.LATCHED}


class StepPublisher:
    """Publishes bytes that :mod:`ik_node.messages` made, so that a recording holds exactly what was sent."""

    def __init__(self, node: Any) -> None:
        self._name = node.get_fully_qualified_name()
        self._publishers = {
            topic: node.create_publisher(
                kind, topic if topic.startswith("/") else f"~/{topic}", SPECIAL_QOS.get(topic, qos.OUTPUT)
            )
            for topic, kind in MESSAGE_TYPES.items()
        }
        self.topics = {topic: publisher.topic_name for topic, publisher in self._publishers.items()}
        # Not among the recorded topics: made of what is recorded, and only while somebody looks.
        self._marker_publisher = node.create_publisher(MarkerArray, "~/markers", qos.OUTPUT)
        self._markers: SceneMarkers | None = None
        self._outputs: StepOutputs | None = None
        self._method = ""
        self._last: Step | None = None
        self._last_status: Status | None = None
        self._joint_count = 0

    def configure(self, robot: Robot, settings: Settings) -> None:
        """From now on Steps are those of this robot."""
        self._outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)
        self._markers = SceneMarkers(robot.base_frame)
        self._method = settings.control.method
        self._joint_count = robot.n

    @property
    def listeners(self) -> int:
        """How many listen to the commands."""
        return int(self._publishers[encode.COMMANDS].get_subscription_count())

    def step(self, step: Step) -> list[Outgoing]:
        """Publishes a step; returns what was sent, the command first."""
        if self._outputs is None:
            return []
        command = Outgoing(encode.COMMANDS, self._outputs.command(step))
        self._publishers[encode.COMMANDS].publish(command.data)
        self._last = step
        others = self._outputs.others(step)
        for topic, data in others:
            self._publishers[topic].publish(data)
        if self._markers is not None:
            self._markers.see(step)
        return [command, *others]

    def zeros(self) -> None:
        """One more zero command: harmless, and certain to be the last word.

        Waits a moment until it has arrived: a process that ends at once takes it along.
        """
        self._publishers[encode.COMMANDS].publish(encode.encode_command(np.zeros(self._joint_count)))
        self._publishers[encode.COMMANDS].wait_for_all_acked(LAST_WORD)

    def status(self, status: Status) -> Outgoing | None:
        """Publishes the status if it has changed since last time."""
        if status == self._last_status:
            return None
        self._last_status = status
        said = Outgoing(encode.STATUS, encode.encode_status(status, self._name, self._values()))
        self._publishers[encode.STATUS].publish(said.data)
        return said

    def diagnostics(self, status: Status, now: Instant, values: Mapping[str, str]) -> Outgoing:
        """Publishes /diagnostics, with these ``values`` beside those of the last step."""
        data = encode.encode_diagnostics([(status, self._name, {**self._values(), **values})], now.ros_ns)
        self._publishers[encode.DIAGNOSTICS].publish(data)
        return Outgoing(encode.DIAGNOSTICS, data)

    def markers(self, scene: Scene, now: Instant) -> None:
        """Publishes the run as markers, if anybody looks; what was missed meanwhile is in the next ones."""
        if self._markers is not None and self._marker_publisher.get_subscription_count():
            self._marker_publisher.publish(self._markers.say(scene, now))

    def no_markers(self, now: Instant) -> None:
        """Takes the markers away, from those who look; waits a moment, since the process may be about to end."""
        if self._markers is not None and self._marker_publisher.get_subscription_count():
            self._marker_publisher.publish(self._markers.end(now))
            self._marker_publisher.wait_for_all_acked(LAST_WORD)

    def _values(self) -> dict[str, str]:
        return {} if self._last is None else encode.step_values(self._last, self._method)

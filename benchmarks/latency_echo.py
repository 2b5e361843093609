"""A rclpy node that answers each joint state with its positions: what DDS, Python and rclpy take by themselves.

It has the topics, the quality of service and the executor of the node, and decodes and encodes the same messages.
"""

from __future__ import annotations

import sys
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ik_node.ros import qos, spin


class EchoNode(Node):  # type: ignore[misc]
    """Publishes the positions of each joint state as a command."""

    def __init__(self) -> None:
        super().__init__("echo")
        self._commands = self.create_publisher(Float64MultiArray, "~/commands", qos.COMMAND)
        self.create_subscription(JointState, "~/joint_states", self._on_state, qos.STREAM)

    def _on_state(self, message: JointState) -> None:
        self._commands.publish(Float64MultiArray(data=message.position))


def _finish(node: Any, executor: Any) -> None:
    del node, executor


if __name__ == "__main__":
    sys.exit(spin.run(EchoNode, _finish, None))

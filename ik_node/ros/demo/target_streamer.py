"""The node of the demonstration that streams a trajectory as target poses and observes the result."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages import decode, encode
from ik_node.robot.robot import Robot
from ik_node.ros import qos


class TargetStreamer(Node):  # type: ignore[misc]
    """Publishes targets for ``/ik_node``; subscribes to joint states and to the status of the node."""

    def __init__(self, robot: Robot, executor: Any) -> None:
        super().__init__("ik_demo")
        self._robot = robot
        self._executor = executor
        self._q: Array | None = None
        self._status: DiagnosticStatus | None = None
        self._targets = self.create_publisher(PoseStamped, "/ik_node/target_pose", qos.OUTPUT)
        self.create_subscription(JointState, "joint_states", self._on_joint_state, qos.STREAM, raw=True)
        self.create_subscription(DiagnosticStatus, "/ik_node/status", self._on_status, qos.LATCHED)
        executor.add_node(self)

    @property
    def status(self) -> tuple[str, str]:
        """Mode and reason of the last status; empty before the first one."""
        if self._status is None:
            return "", ""
        return next(entry.value for entry in self._status.values if entry.key == "mode"), self._status.message

    def measured_pose(self) -> Array:
        """Return T_sb of the newest joint state, (4, 4)."""
        if self._q is None:
            raise IkNodeError("no joint state has been received")
        return self._robot.pose(self._q)

    def wait_until_ready(self, timeout_s: float, check: Callable[[], None]) -> None:
        """Wait until the node controls the arm and subscribes to the targets; ``check`` raises to end the wait."""
        end_s = time.monotonic() + timeout_s
        while not (self.status[0] == "holding" and self._q is not None and self._targets.get_subscription_count()):
            if time.monotonic() > end_s:
                raise IkNodeError(f"nodes not ready within {timeout_s:g} s; last status: {self.status}")
            self.spin(0.05)
            check()

    def stream(self, targets: Iterator[tuple[float, Array]], each: Callable[[float], bool]) -> int:
        """Publish target poses at their times.

        Args:
            targets: (time_s, T_sd); the time is also the stamp.
            each: Called with the time at least every 0.05 s; returns False to end the stream.

        Returns:
            ROS time of time 0, ns.
        """
        start_ns, start_ros_ns = time.monotonic_ns(), int(self.get_clock().now().nanoseconds)
        for time_s, pose_sd in targets:
            due_ns = start_ns + round(time_s * NS)
            while (left_ns := due_ns - time.monotonic_ns()) > 0:
                self.spin(min(left_ns / NS, 0.05))
                if not each((time.monotonic_ns() - start_ns) / NS):
                    return start_ros_ns
            self._publish(pose_sd, start_ros_ns + round(time_s * NS))
        return start_ros_ns

    def spin_for(self, duration_s: float) -> None:
        """Handle messages for ``duration_s``."""
        end_s = time.monotonic() + duration_s
        while time.monotonic() < end_s:
            self.spin(0.05)

    def spin(self, timeout_s: float) -> None:
        """Handle one message, or return after ``timeout_s``."""
        self._executor.spin_once(timeout_s)

    def _publish(self, pose_sd: Array, stamp_ns: int) -> None:
        quaternion = se3.quaternion_from_rotation(pose_sd[:3, :3])
        self._targets.publish(encode.encode_pose(self._robot.base_frame, stamp_ns, pose_sd[:3, 3], quaternion))

    def _on_joint_state(self, data: bytes) -> None:
        sample = decode.decode_joint_state(data)
        index_of = {name: index for index, name in enumerate(sample.names)}
        self._q = np.array([sample.position[index_of[name]] for name in self._robot.joints])

    def _on_status(self, message: DiagnosticStatus) -> None:
        self._status = message

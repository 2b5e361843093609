"""A node that stops the arm when the controlling node was killed or hangs; it runs in a process of its own.

A forward_command_controller keeps its last velocity. Each command of the controlling node is accompanied by a message
on its topic ``joint_velocity``, which no other node publishes. This node publishes zeros on the command topic when no
such message follows a non-zero one in time. Commands of others, on the same command topic, are not read.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Sequence
from types import FrameType
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from ik_node.interfaces.step import Level, Mode, Status
from ik_node.messages import encode
from ik_node.ros import parameters, qos
from ik_node.ros.spin import SPIN_TIMEOUT_S
from ik_node.ros.steady_timer import create_steady_timer
from ik_node.settings.schema import Descriptor

CHECKS_PER_TIMEOUT = 20
"""The timeout is checked this often."""
LATE_CHECKS = 2
"""Consecutive checks that must find the timeout exceeded. After a hold-up of this process the messages that queued up
are processed between the first check and the second one. The timeout is exceeded by at most a tenth."""
READY_PERIOD_S = 0.1
"""Period of the check whether ``ik_node`` is there."""
REPETITIONS = 5
"""Number of zero commands that are published."""
TIMEOUT = Descriptor(
    "timeout_s",
    0.1,
    "Longest time without a command after a non-zero one; then the arm is stopped.",
    "s",
    0.01,
    10.0,
    (),
    True,
    float,
    0,
)
"""The only parameter, read at the start."""
READY = "monitoring ik_node"
"""Reason of the status from the time when ``ik_node`` and a subscriber of the commands are connected."""


class WatchdogNode(Node):  # type: ignore[misc]
    """Monitors ``ik_node/joint_velocity`` and publishes on ``ik_node/commands``, relative to its namespace.

    Its latched status is on ``ik_node/watchdog``, where ``ik_node`` reads it, and on ``~/status``.
    """

    def __init__(self, arguments: Sequence[str] | None = None) -> None:
        """Read the parameters.

        Args:
            arguments: Those of the process, for warnings about parameter files of other nodes.

        Raises:
            SettingsError: A parameter is unknown or invalid.
        """
        super().__init__("ik_watchdog")
        self._timeout_s: float = parameters.declare_all(self, [TIMEOUT], arguments)[TIMEOUT.name]
        self._last = np.zeros(0)
        self._received_s = time.monotonic()
        self._late_checks = 0
        self._zeros_left = 0
        self._is_ready = False
        self._status = Status(Level.WARN, Mode.WAITING, "not ready: waiting for ik_node")
        self._commands = self.create_publisher(Float64MultiArray, "ik_node/commands", qos.COMMAND)
        self._statuses = [
            self.create_publisher(DiagnosticStatus, topic, qos.LATCHED) for topic in ("~/status", "ik_node/watchdog")
        ]
        self._velocity = self.create_subscription(JointState, "ik_node/joint_velocity", self._on_velocity, qos.STREAM)
        create_steady_timer(self, self._timeout_s / CHECKS_PER_TIMEOUT, self._check)
        create_steady_timer(self, READY_PERIOD_S, self._check_ready)
        self._publish_status(self._status)
        self.get_logger().info(
            f"waiting for {self._velocity.topic_name} and a subscriber on {self._commands.topic_name}"
        )

    def _on_velocity(self, message: JointState) -> None:
        self._last, self._received_s = np.array(message.velocity), time.monotonic()
        self._late_checks = 0
        if self._zeros_left:
            self._zeros_left = 0
            resumed = f"{READY}; its commands have resumed"
            self.get_logger().info(resumed)
            self._publish_status(Status(Level.OK, Mode.WAITING, resumed))

    def _check(self) -> None:
        is_late = self._last.any() and time.monotonic() - self._received_s > self._timeout_s
        self._late_checks = self._late_checks + 1 if is_late else 0
        if self._zeros_left == 0 and self._late_checks >= LATE_CHECKS:
            self._zeros_left = REPETITIONS
            reason = f"no command for {self._timeout_s:g} s after a non-zero one; the arm was stopped"
            self.get_logger().error(reason)
            self._publish_status(Status(Level.ERROR, Mode.STOPPED, reason))
        if self._zeros_left:
            self._commands.publish(encode.encode_command(np.zeros(len(self._last))))
            self._zeros_left -= 1
            if self._zeros_left == 0:
                self._last = np.zeros(len(self._last))

    def _check_ready(self) -> None:
        """Report when ``ik_node`` and a subscriber of the commands have been found, or were lost."""
        topics = []
        if not self.count_publishers(self._velocity.topic_name):
            topics.append(f"a publisher on {self._velocity.topic_name}")
        if not self._commands.get_subscription_count():
            topics.append(f"a subscriber on {self._commands.topic_name}")
        if self._is_ready == (not topics):
            return
        self._is_ready = not topics
        reason = f"not ready: waiting for {' and '.join(topics)}" if topics else READY
        if not topics:
            self.get_logger().info(f"ready: zeros on {self._commands.topic_name} after {self._timeout_s:g} s")
        elif self._status.level is Level.ERROR:
            return  # the reason for the zeros stays
        else:
            self.get_logger().warning(reason)
        self._publish_status(Status(Level.WARN if topics else Level.OK, Mode.WAITING, reason))

    def _publish_status(self, status: Status) -> None:
        self._status = status
        data = encode.encode_status(status, self.get_fully_qualified_name())
        for publisher in self._statuses:
            publisher.publish(data)

    def finish(self, executor: Any) -> None:
        """Monitor until the commands are zero: the signal may have reached ``ik_node`` too, which ramps to zero then.

        SIGTERM ends this at once.
        """
        ended = Future()

        def end(number: int, frame: FrameType | None) -> None:
            del number, frame
            ended.set_result(None)

        def end_at_rest() -> None:
            if not self._last.any():
                ended.set_result(None)

        signal.signal(signal.SIGTERM, end)
        if self._last.any():
            self.get_logger().info("ends when the commands are zero; SIGTERM ends it at once")
            create_steady_timer(self, self._timeout_s / CHECKS_PER_TIMEOUT, end_at_rest)
            executor.spin_until_future_complete(ended, SPIN_TIMEOUT_S)

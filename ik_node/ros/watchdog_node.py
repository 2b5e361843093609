"""A node that stops the arm when the controlling node was killed or hangs; it runs in a process of its own.

A forward_command_controller keeps its last velocity. This node subscribes to the commands and publishes zeros on the
same topic when no command follows a non-zero one in time.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray

from ik_node.errors import InputError
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.messages import decode, encode
from ik_node.ros import qos

CHECKS_PER_TIMEOUT = 10
"""The timeout is checked this often, so that it is exceeded by at most a tenth."""
REPETITIONS = 5
"""Number of zero commands that are published."""


class WatchdogNode(Node):  # type: ignore[misc]
    """Monitors ``/ik_node/commands`` (can be remapped)."""

    def __init__(self) -> None:
        super().__init__("ik_watchdog")
        valid = FloatingPointRange(from_value=0.01, to_value=10.0)
        about = ParameterDescriptor(
            description="Longest time without a command after a non-zero one; then the arm is stopped [s].",
            floating_point_range=[valid],
        )
        self._timeout_s = float(self.declare_parameter("timeout_s", 0.1, about).value)
        self._last = np.zeros(0)
        self._received_s = time.monotonic()
        self._zeros_left = 0
        self._commands = self.create_publisher(Float64MultiArray, "/ik_node/commands", qos.COMMAND)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", qos.LATCHED)
        self.create_subscription(Float64MultiArray, "/ik_node/commands", self._on_command, qos.OUTPUT, raw=True)
        self.create_timer(self._timeout_s / CHECKS_PER_TIMEOUT, self._check)
        self._publish_status(Status(Level.OK, Mode.WAITING, "monitoring"))

    def _on_command(self, data: bytes) -> None:
        try:
            command = decode.decode_command(data)
        except InputError:
            return
        if self._zeros_left and not command.any():
            return  # a zero command of this node
        self._last, self._received_s = command, time.monotonic()
        if self._zeros_left:
            self._zeros_left = 0
            self._publish_status(Status(Level.OK, Mode.WAITING, "monitoring; commands have resumed"))

    def _check(self) -> None:
        if self._zeros_left == 0 and self._last.any() and time.monotonic() - self._received_s > self._timeout_s:
            self._zeros_left = REPETITIONS
            reason = f"no command for {self._timeout_s:g} s after a non-zero one; the arm was stopped"
            self.get_logger().error(reason)
            self._publish_status(Status(Level.ERROR, Mode.STOPPED, reason))
        if self._zeros_left:
            self._commands.publish(encode.encode_command(np.zeros(len(self._last))))
            self._zeros_left -= 1
            if self._zeros_left == 0:
                self._last = np.zeros(len(self._last))

    def _publish_status(self, status: Status) -> None:
        self._status.publish(encode.encode_status(status, self.get_fully_qualified_name()))

    def finish(self, executor: Any) -> None:
        """Do nothing: there is nothing to close."""
        del executor

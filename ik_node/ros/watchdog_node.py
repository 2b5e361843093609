"""A second process that stops the arm when the first one cannot: it was killed, or hangs.

A forward_command_controller keeps the last velocity for ever. This node listens to the commands; when the last one was
not zero and no other follows in time, it says zero on the same topic.
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
"""The silence is noticed at most this part of the time-out late."""
REPETITIONS = 5
"""Zeros are said so often: nobody answers for this message."""


class WatchdogNode(Node):  # type: ignore[misc]
    """Watches ``/ik_node/commands`` (remappable)."""

    def __init__(self) -> None:
        super().__init__("ik_watchdog")
        valid = FloatingPointRange(from_value=0.01, to_value=10.0)
        about = ParameterDescriptor(
            description="Without a command for this long after one that was not zero, the arm is stopped [s].",
            floating_point_range=[valid],
        )
        self._timeout_s = float(self.declare_parameter("timeout_s", 0.1, about).value)
        self._last = np.zeros(0)
        self._heard_s = time.monotonic()
        self._zeros_left = 0
        self._commands = self.create_publisher(Float64MultiArray, "/ik_node/commands", qos.COMMAND)
        self._status = self.create_publisher(DiagnosticStatus, "~/status", qos.LATCHED)
        self.create_subscription(Float64MultiArray, "/ik_node/commands", self._on_command, qos.OUTPUT, raw=True)
        self.create_timer(self._timeout_s / CHECKS_PER_TIMEOUT, self._check)
        self._say(Status(Level.OK, Mode.WAITING, "watching"))

    def _on_command(self, data: bytes) -> None:
        try:
            command = decode.decode_command(data)
        except InputError:
            return
        if self._zeros_left and not command.any():
            return  # our own zeros, heard back
        self._last, self._heard_s = command, time.monotonic()
        if self._zeros_left:
            self._zeros_left = 0
            self._say(Status(Level.OK, Mode.WAITING, "watching; commands have come back"))

    def _check(self) -> None:
        if self._zeros_left == 0 and self._last.any() and time.monotonic() - self._heard_s > self._timeout_s:
            self._zeros_left = REPETITIONS
            reason = f"no command for {self._timeout_s:g} s after one that was not zero; the arm was stopped"
            self.get_logger().error(reason)
            self._say(Status(Level.ERROR, Mode.STOPPED, reason))
        if self._zeros_left:
            self._commands.publish(encode.encode_command(np.zeros(len(self._last))))
            self._zeros_left -= 1
            if self._zeros_left == 0:
                self._last = np.zeros(len(self._last))

    def _say(self, status: Status) -> None:
        self._status.publish(encode.encode_status(status, self.get_fully_qualified_name()))

    def finish(self, executor: Any) -> None:
        """Nothing is left to do."""
        del executor

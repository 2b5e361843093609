"""A simulated arm as a node: subscribes to velocity commands, publishes joint states and the robot description."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from ik_node.control.start_posture import choose_start_posture
from ik_node.errors import InputError
from ik_node.messages import decode, encode
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.robot.simulator_parameters import PARAMETERS, SIMULATOR, arm_model, arm_settings, start_position
from ik_node.ros import parameters, qos
from ik_node.ros.steady_timer import create_steady_timer
from ik_node.ros.throttled_log import ThrottledLog


class SimulatorNode(Node):  # type: ignore[misc]
    """Simulated arm that subscribes where ``ik_node`` publishes, and publishes joint states and its description."""

    def __init__(self, arguments: Sequence[str] | None = None) -> None:
        """Read the parameters.

        Args:
            arguments: Those of the process, for warnings about parameter files of other nodes.

        Raises:
            RobotError: The parameters do not describe an arm.
            SettingsError: A parameter is unknown or invalid.
        """
        super().__init__(SIMULATOR)
        values = parameters.declare_all(self, PARAMETERS, arguments)
        robot = robot_from_settings(arm_settings(values))
        position = start_position(values, robot.joints)
        if position is None:
            chosen = choose_start_posture(robot)
            position = chosen.position
            self.get_logger().info(chosen.describe(robot.joints))
        self._joints = robot.joints
        self._log = ThrottledLog(self)
        self._arm = SimulatedArm(position, robot.limits, time.monotonic_ns(), arm_model(values))
        self._states = self.create_publisher(JointState, "joint_states", qos.OUTPUT)
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._description.publish(String(data=robot.urdf))
        commands = self.create_subscription(
            Float64MultiArray, "ik_node/commands", self._on_command, qos.COMMAND, raw=True
        )
        create_steady_timer(self, 1.0 / values["rate_hz"], self._publish)
        rate = f"{values['rate_hz']:g} Hz on {self._states.topic_name}"
        self._waiting = f"{robot.name}: joint states at {rate}; waiting for commands on {commands.topic_name}"
        self.get_logger().info(self._waiting)

    def _on_command(self, data: bytes) -> None:
        try:
            self._arm.command(decode.decode_command(data), time.monotonic_ns())
            if self._waiting:
                self._waiting = ""
                self.get_logger().info("commands arrive")
        except InputError as error:
            self._log.warning("command", f"command dropped: {error}")

    def _publish(self) -> None:
        time_ns, stamp_ns = time.monotonic_ns(), self.get_clock().now().nanoseconds
        position, (_, velocity) = self._arm.measure(time_ns), self._arm.advance(time_ns)
        if position is None:
            return
        frame_id = decode.SIMULATED_ARM
        self._states.publish(encode.encode_joint_state(self._joints, stamp_ns, position, velocity, frame_id))

    def finish(self, executor: Any) -> None:
        """Do nothing: nothing moves that has to be stopped."""
        del executor

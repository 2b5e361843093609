"""A simulated arm as a node: subscribes to velocity commands, publishes joint states and the robot description."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from ik_node.control.start_posture import choose_start_posture
from ik_node.errors import InputError, SettingsError
from ik_node.messages import decode, encode
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.ros import qos
from ik_node.ros.steady_timer import create_steady_timer
from ik_node.settings.groups import ArmSettings

NOT_CONFIGURED = [0.0]
"""Default of initial_position: ROS needs a list that is not empty to know the type of its elements."""


class SimulatorNode(Node):  # type: ignore[misc]
    """Simulated arm with the topics of a forward_command_controller and a joint_state_broadcaster."""

    def __init__(self) -> None:
        """Read the parameters; raises RobotError or SettingsError when they do not describe an arm."""
        super().__init__("ik_simulator")
        arm = ArmSettings(
            robot=self._text("robot", "panda", "Name of a robot in example-robot-data."),
            robot_description=self._text("robot_description", "", "URDF as text, instead of robot."),
            base_frame=self._text("base_frame", "", "As for ik_node."),
            tip_frame=self._text("tip_frame", "", "As for ik_node."),
            joint_prefix=self._text("joint_prefix", "", "As for ik_node."),
        )
        about = ParameterDescriptor(description="Rate of the joint states [Hz].", read_only=True)
        rate_hz = self.declare_parameter("rate_hz", 500.0, about).value
        about = ParameterDescriptor(
            description="Joint positions at the start [rad, m]; default: chosen.", read_only=True
        )
        start = self.declare_parameter("initial_position", NOT_CONFIGURED, about).value
        robot = robot_from_settings(arm)
        position = np.array(start, dtype=np.float64)
        if position.tolist() == NOT_CONFIGURED:
            chosen = choose_start_posture(robot)
            position = chosen.position
            self.get_logger().info(chosen.describe(robot.joints))
        if position.shape != (robot.n,):
            raise SettingsError(f"initial_position has {position.size} values, expected {robot.n}: {robot.joints}")
        self._joints = robot.joints
        model = {field.name: self._number(field) for field in dataclasses.fields(ArmModel)}
        self._arm = SimulatedArm(position, robot.limits, time.monotonic_ns(), ArmModel(**model))
        self._states = self.create_publisher(JointState, "joint_states", qos.OUTPUT)
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._description.publish(String(data=robot.urdf))
        self.create_subscription(Float64MultiArray, "commands", self._on_command, qos.COMMAND, raw=True)
        create_steady_timer(self, 1.0 / rate_hz, self._publish)

    def _text(self, name: str, default: str, description: str) -> str:
        about = ParameterDescriptor(description=description, read_only=True)
        return str(self.declare_parameter(name, default, about).value)

    def _number(self, field: dataclasses.Field[Any]) -> Any:
        unit = f" [{field.metadata['unit']}]" if field.metadata["unit"] else ""
        about = ParameterDescriptor(description=field.metadata["description"] + unit, read_only=True)
        return self.declare_parameter(field.name, field.default, about).value

    def _on_command(self, data: bytes) -> None:
        try:
            self._arm.command(decode.decode_command(data), time.monotonic_ns())
        except InputError as error:
            self.get_logger().warning(f"command dropped: {error}", throttle_duration_sec=1.0)

    def _publish(self) -> None:
        time_ns, stamp_ns = time.monotonic_ns(), self.get_clock().now().nanoseconds
        position, (_, velocity) = self._arm.measure(time_ns), self._arm.advance(time_ns)
        if position is None:
            return
        self._states.publish(encode.encode_joint_state(self._joints, stamp_ns, position, velocity))

    def finish(self, executor: Any) -> None:
        """Do nothing: nothing moves that has to be stopped."""
        del executor

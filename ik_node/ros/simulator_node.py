"""A simulated arm as a node: subscribes to velocity commands, publishes joint states and the robot description."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from ik_node.control.start_posture import choose_start_posture
from ik_node.errors import InputError, SettingsError
from ik_node.messages import decode, encode
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.ros import parameters, qos
from ik_node.ros.steady_timer import create_steady_timer
from ik_node.ros.throttled_log import ThrottledLog
from ik_node.settings.groups import ArmSettings, describe
from ik_node.settings.schema import Descriptor

ARM_NAMES = ("robot", "robot_description", "base_frame", "tip_frame", "joint_prefix")
"""Parameters that are those of ``ik_node``."""
ROBOT = "panda"
"""Default of ``robot``, unless ``robot_description`` is given."""


def _parameters() -> Iterator[Descriptor]:
    for about in describe():
        if about.name in ARM_NAMES:
            yield about._replace(read_only=True, default=ROBOT if about.name == "robot" else about.default)
    number = Descriptor("rate_hz", 500.0, "Rate of the joint states.", "Hz", 1.0, 10_000.0, (), True, float, 0)
    yield number
    start = "Joint positions at the start; without values they are chosen."
    yield number._replace(
        name="initial_position", default=(), description=start, unit="rad or m", minimum=None, maximum=None
    )
    for field in dataclasses.fields(ArmModel):
        default: Any = field.default
        yield Descriptor(**{"name": field.name, "default": default, **field.metadata, "read_only": True})


PARAMETERS = tuple(_parameters())
"""Parameters of the simulated arm, read at the start."""


class SimulatorNode(Node):  # type: ignore[misc]
    """Simulated arm with the topics of a forward_command_controller and a joint_state_broadcaster."""

    def __init__(self, arguments: Sequence[str] | None = None) -> None:
        """Read the parameters.

        Args:
            arguments: Those of the process, for warnings about parameter files of other nodes.

        Raises:
            RobotError: The parameters do not describe an arm.
            SettingsError: A parameter is unknown or invalid.
        """
        super().__init__("ik_simulator")
        values = parameters.declare_all(self, PARAMETERS, arguments)
        robot = robot_from_settings(ArmSettings(**{name: values[name] for name in ARM_NAMES}))
        if values["initial_position"]:
            position = np.array(values["initial_position"], dtype=np.float64)
        else:
            chosen = choose_start_posture(robot)
            position = chosen.position
            self.get_logger().info(chosen.describe(robot.joints))
        if position.shape != (robot.n,):
            raise SettingsError(f"initial_position has {position.size} values, expected {robot.n}: {robot.joints}")
        self._joints = robot.joints
        self._log = ThrottledLog(self)
        model = {field.name: values[field.name] for field in dataclasses.fields(ArmModel)}
        self._arm = SimulatedArm(position, robot.limits, time.monotonic_ns(), ArmModel(**model))
        self._states = self.create_publisher(JointState, "joint_states", qos.OUTPUT)
        self._description = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._description.publish(String(data=robot.urdf))
        self.create_subscription(Float64MultiArray, "commands", self._on_command, qos.COMMAND, raw=True)
        create_steady_timer(self, 1.0 / values["rate_hz"], self._publish)

    def _on_command(self, data: bytes) -> None:
        try:
            self._arm.command(decode.decode_command(data), time.monotonic_ns())
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

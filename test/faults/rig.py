"""Drives an arm, a target and a fault against a node over DDS.

The arm integrates the received commands; the target is a circle about its start. A fault replaces :attr:`Rig.states` or
:attr:`Rig.targets`, the functions that alter what is sent, or calls another method.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from ros_peer import Peer, rclpy

from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.ros import qos

if rclpy:
    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import PoseStamped
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState
    from std_srvs.srv import SetBool, Trigger

NS = 1_000_000_000
STATE_PERIOD_S = 0.01
TARGETS_EVERY = 2
"""One target for this many joint states."""
RADIUS_M, TURN_S = 0.06, 2.0
MOVING = 0.08
"""Speed of the fastest joint, rad/s, from which the arm is moving."""
LATE_S = 0.05
"""Time between two joint states of this process from which on it counts as held up."""
PATIENCE_S = 60.0
"""Longest wait for an expected status, also on a busy machine; the time of each fault is measured from the recording.
"""


class Rig:
    """Arm, target and fault of one node."""

    def __init__(self, peer: Peer, robot: Robot, start: Sequence[float], simulated_time: bool = False) -> None:
        self.peer, self.robot = peer, robot
        self.start = np.array(start)
        self.position = self.start.copy()
        self.centre = robot.pose(self.start)
        self.offset_ns = -time.time_ns() + 1_000_000 * NS if simulated_time else 0
        """ROS time less system time."""
        self.clock_runs = simulated_time
        self._clock = peer.node.create_publisher(Clock, "/clock", 10) if simulated_time else None
        self._publishers: dict[str, Any] = {}
        self._last_s = self._next_s = time.monotonic()
        self._turn_s = 0.0
        self._count = 0
        self.longest_gap_s = 0.0
        """Longest time between two joint states of this process, since it was set to 0."""
        self.held_up_s = 0.0
        """For how long this process was held up in all since the last fault."""
        self.answer = ""
        """What a service or parameter call of the fault answered."""
        self.fault_ns = self.first_status = self.first_command = 0
        """Monotonic time of the fault; indices of the first status and the first command after it."""
        self.restore()

    def restore(self) -> None:
        """End the alteration of all inputs."""
        self.states: Callable[[Any], Iterable[Any]] = lambda message: (message,)
        self.targets: Callable[[Any], Iterable[Any]] = lambda message: (message,)
        self.obeys: Callable[[Array], Array] = lambda command: command
        self.each: Callable[[], object] | None = None
        self.states_every = 1
        self.targets_every = TARGETS_EVERY
        self.clock_runs = self._clock is not None

    def mark(self) -> None:
        """The fault begins now."""
        self.fault_ns, self.held_up_s = time.monotonic_ns(), 0.0
        self.first_status, self.first_command = len(self.peer.statuses), len(self.peer.commands)

    # --- what is sent ------------------------------------------------------------------------------------------------

    def stamp(self, age_s: float = 0.0) -> Any:
        """Present ROS time, or that of ``age_s`` ago."""
        now_ns = max(time.time_ns() + self.offset_ns - round(age_s * NS), 0)
        return Time(sec=now_ns // NS, nanosec=now_ns % NS)

    def goal(self) -> Array:
        """Present target T_sd."""
        pose = self.centre.copy()
        angle = 2.0 * np.pi * self._turn_s / TURN_S
        pose[:3, 3] += RADIUS_M * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)])
        return np.asarray(pose)

    def pose_message(self, pose: Array | None = None, frame: str = "panda_link0") -> Any:
        """PoseStamped of a pose; default: of the target."""
        pose = self.goal() if pose is None else pose
        message = PoseStamped()
        message.header.frame_id, message.header.stamp = frame, self.stamp()
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = pose[:3, 3].tolist()
        q.x, q.y, q.z, q.w = se3.quaternion_from_rotation(pose[:3, :3]).tolist()
        return message

    def tick(self) -> None:
        """Move the arm, and send one joint state and sometimes a target, when they are due."""
        now = time.monotonic()
        if now < self._next_s:
            return
        self._next_s = max(self._next_s + STATE_PERIOD_S, now - STATE_PERIOD_S)
        elapsed_s, self._last_s = now - self._last_s, now
        self.longest_gap_s = max(self.longest_gap_s, elapsed_s)
        self.held_up_s += elapsed_s if elapsed_s > LATE_S else 0.0
        self._turn_s += min(elapsed_s, 0.1)
        command = self.peer.commands[-1] if self.peer.commands else np.zeros(self.robot.n)
        if np.isfinite(command).all():
            self.position = self.position + min(elapsed_s, 0.5) * self.obeys(command)
        if self._clock is not None and self.clock_runs:
            self._clock.publish(Clock(clock=self.stamp()))
        self._count += 1
        if self._count % self.states_every == 0:
            message = JointState(name=list(self.robot.joints), position=self.position.tolist())
            message.header.stamp = self.stamp()
            for sent in self.states(message):
                self.peer.states_publisher.publish(sent)
        if self._count % self.targets_every == 0:
            for sent in self.targets(self.pose_message()):
                self.peer.targets_publisher.publish(sent)
        if self.each is not None:
            self.each()

    def publish(self, topic: str, kind: Any, message: Any) -> None:
        """Publish a message or its bytes on another topic, once the node has subscribed to it; None: nothing yet."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self.peer.node.create_publisher(kind, topic, qos.OUTPUT)
            self.until(lambda: publisher.get_subscription_count() > 0)
        if message is not None:
            publisher.publish(message)

    # --- time passes -------------------------------------------------------------------------------------------------

    def spin(self, duration_s: float) -> None:
        """Process callbacks and drive the arm."""
        self.peer.spin(duration_s, self.tick, 0.002)

    def until(self, holds: Callable[[], object], limit_s: float = PATIENCE_S) -> bool:
        """Drive the arm until a condition holds; False when it did not within ``limit_s``."""
        begin_s = time.monotonic()
        while not holds():
            if time.monotonic() > begin_s + limit_s:
                return False
            self.spin(0.01)
        return True

    @property
    def moving(self) -> bool:
        """True while the arm is commanded to move."""
        return bool(self.peer.commands) and bool(np.abs(self.peer.commands[-1]).max() > MOVING)

    def until_moving(self) -> bool:
        """Drive the arm until it follows the target; False when it did not."""
        return self.until(lambda: self.peer.mode == "tracking" and self.moving)

    # --- requests ----------------------------------------------------------------------------------------------------

    def pause(self, on: bool = True) -> None:
        """Call the service ``pause``."""
        self.answer = self._call(SetBool, "pause", SetBool.Request(data=on)).message

    def reset(self) -> None:
        """Call the service ``reset``."""
        self.answer = self._call(Trigger, "reset", Trigger.Request()).message

    def set(self, **values: Any) -> None:
        """Set parameters (``__`` for a point in a name), all at once; the answer is in :attr:`answer`."""
        named = [
            Parameter(name=name.replace("__", "."), value=parameter_value(value)) for name, value in values.items()
        ]
        results = self._call(SetParameters, "set_parameters", SetParameters.Request(parameters=named)).results
        self.answer = "; ".join(result.reason for result in results if not result.successful)

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        return self.peer.call(kind, f"/ik_node/{name}", request, self.tick)


def parameter_value(value: Any) -> Any:
    """A ParameterValue of the type of a value."""
    if isinstance(value, bool):
        return ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=value)
    if isinstance(value, int):
        return ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=value)
    if isinstance(value, float):
        return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    if value and isinstance(value[0], str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=list(value))
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[float(v) for v in value])

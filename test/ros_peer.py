"""Counterpart of the node under test: real processes and real DDS, with a separate domain for every test."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from domains import own_domain

from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")

from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from geometry_msgs.msg import PoseStamped  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from warm_nodes import start_node  # noqa: E402

from ik_node.ros import qos  # noqa: E402
from ik_node.ros.child_process import NodeProcess  # noqa: E402

CALM = ["-p", "rate_hz:=50.0", "-p", "state.timeout_s:=10.0", "-p", "follow.enabled:=false"]
"""The state machine tolerates late joint states, so 15 Hz are enough."""
PATIENCE_S = 120.0
"""Time-out after which an expected message counts as missing, also on a busy machine."""


class Peer:
    """Sends input to and receives output from a node called ``/ik_node`` (or another name) in one domain."""

    def __init__(self, domain: int, node_name: str = "/ik_node") -> None:
        self.domain = domain
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = Node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.commands: list[Array] = []
        self.command_times_ns: list[int] = []
        """Monotonic times of arrival of :attr:`commands`."""
        self.statuses: list[tuple[str, str]] = []
        self.processes: list[NodeProcess] = []
        self.states_publisher = self.node.create_publisher(JointState, "/joint_states", qos.OUTPUT)
        self.targets_publisher = self.node.create_publisher(PoseStamped, f"{node_name}/target_pose", qos.OUTPUT)
        self._command_topic = f"{node_name}/commands"
        self.subscribe_commands()
        self.node.create_subscription(DiagnosticStatus, f"{node_name}/status", self._on_status, qos.LATCHED)

    # --- the process under test --------------------------------------------------------------------------------------

    def start(self, executable: str, folder: Path, arguments: Sequence[str] = ()) -> NodeProcess:
        """Start an executable of the package in this domain; it is stopped when the test ends."""
        environment = {"ROS_DOMAIN_ID": str(self.domain)}
        log = folder / f"{executable}_{len(self.processes)}.log"
        process = start_node(f"ik_node.cli.{executable}", arguments, environment, log)
        self.processes.append(process)
        return process

    def close(self) -> None:
        """Stop the started processes and leave the domain."""
        for process in reversed(self.processes):  # the watchdog, started first, ends after the node
            process.stop(signal.SIGTERM, 30.0)
        self.executor.shutdown(0.5)
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)

    # --- input -------------------------------------------------------------------------------------------------------

    def send_state(self, names: Sequence[str], position: Sequence[float] | Array) -> None:
        """Publish a joint state with the present time as stamp."""
        message = JointState(name=list(names), position=[float(value) for value in position])
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.states_publisher.publish(message)

    def send_target(self, pose: Array, frame: str, scale_quaternion: float = 1.0) -> None:
        """Publish a target with the present time as stamp."""
        message = PoseStamped()
        message.header.frame_id = frame
        message.header.stamp = self.node.get_clock().now().to_msg()
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = pose[:3, 3].tolist()
        quaternion = scale_quaternion * se3.quaternion_from_rotation(pose[:3, :3])
        q.x, q.y, q.z, q.w = quaternion.tolist()
        self.targets_publisher.publish(message)

    def spin(self, duration_s: float, each: Callable[[], None] | None = None, period_s: float = 0.004) -> None:
        """Process callbacks for a duration; ``each`` is called about every ``period_s``."""
        until, next_s = time.monotonic() + duration_s, time.monotonic()
        while (now := time.monotonic()) < until:
            if each is not None and now >= next_s:
                each()
                next_s = max(next_s + period_s, now)
            self.executor.spin_once(timeout_sec=0.002)

    def until(
        self,
        what: str,
        holds: Callable[[], bool],
        each: Callable[[], None] | None = None,
        now_and_then: Callable[[], None] | None = None,
        period_s: float = 1.0,
    ) -> None:
        """Process callbacks until ``holds`` returns true; after the time-out the test fails and lists what was
        received.

        ``now_and_then`` is called at once and then every ``period_s``, for messages that may be sent before the other
        side has discovered the publisher. Its calls are never closer to each other, also after a hold-up of the test.
        """
        begin = time.monotonic()
        again = begin
        while not holds():
            if time.monotonic() > begin + PATIENCE_S:
                words = "\n".join(process.log_tail() for process in self.processes)
                pytest.fail(f"waited {PATIENCE_S:g} s for {what}; last statuses {self.statuses[-3:]}\n{words}")
            if now_and_then is not None and time.monotonic() >= again:
                now_and_then()
                again = time.monotonic() + period_s
            self.spin(0.02, each)

    def until_silent(self, silence_s: float = 0.5, each: Callable[[], None] | None = None) -> None:
        """Process callbacks until no command has been received for a given time; further commands fail the test."""
        count, since = len(self.commands), time.monotonic()

        def silent() -> bool:
            nonlocal count, since
            if len(self.commands) != count:
                count, since = len(self.commands), time.monotonic()
            return time.monotonic() > since + silence_s

        self.until("no more commands", silent, each)

    def call(self, service_type: Any, name: str, request: Any, each: Callable[[], None] | None = None) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(service_type, name)
        self.until(f"service {name}", client.service_is_ready, each)
        future = client.call_async(request)
        self.until(f"the response of {name}", future.done, each)
        self.node.destroy_client(client)
        return future.result()

    # --- output ------------------------------------------------------------------------------------------------------

    @property
    def mode(self) -> str:
        """Last mode that the node published."""
        return self.statuses[-1][0] if self.statuses else ""

    @property
    def reason(self) -> str:
        """Reason of that mode."""
        return self.statuses[-1][1] if self.statuses else ""

    def subscribe_commands(self, topic: str = "") -> None:
        """Receive commands; done at first, and again after a test has ended the subscription or for another topic."""
        self.node.create_subscription(Float64MultiArray, topic or self._command_topic, self._on_command, qos.OUTPUT)

    def _on_command(self, message: Float64MultiArray) -> None:
        self.commands.append(np.array(message.data))
        self.command_times_ns.append(time.monotonic_ns())

    def _on_status(self, message: DiagnosticStatus) -> None:
        mode = next(entry.value for entry in message.values if entry.key == "mode")
        self.statuses.append((mode, message.message))


class FakeArm:
    """A simulated arm that integrates its commands; it can stop publishing or publish wrong states."""

    def __init__(self, peer: Peer, robot: Robot, position: Sequence[float]) -> None:
        self.peer = peer
        self.robot = robot
        self.position = np.array(position, dtype=np.float64)
        self._last_s = time.monotonic()

    def __call__(self) -> None:
        """Publish one joint state."""
        now = time.monotonic()
        if self.peer.commands:
            self.position = self.position + min(now - self._last_s, 0.05) * self.peer.commands[-1]
        self._last_s = now
        self.peer.send_state(self.robot.joints, self.position)

    def pose(self) -> Array:
        """T_sb."""
        return self.robot.pose(self.position)


@contextmanager
def peer_in_own_domain(node_name: str = "/ik_node") -> Iterator[Peer]:
    """A peer in a reserved domain."""
    with own_domain() as domain:
        peer = Peer(domain, node_name)
        try:
            yield peer
        finally:
            peer.close()

"""The node with ``use_sim_time`` over DDS: whatever /clock does, silent joint states and signals stop the arm."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy
from waiting import ENOUGH_S

if rclpy:
    from builtin_interfaces.msg import Time
    from rosgraph_msgs.msg import Clock

NS = 1_000_000_000
TIMEOUT_S = 0.5
LONGEST_S = 60.0
"""From the last joint state to zeros: ``state.timeout_s``, and a margin for a busy machine. With time-outs in ROS time
it would be infinite, or an hour."""
SILENCES = ("no joint state", "the node was held up")
"""The second one is the reason when the machine holds up the node at the same time."""


class SimulatedTime:
    """Publishes /clock with each joint state of an arm that moves to a target."""

    def __init__(self, peer: Peer, folder: Path) -> None:
        self.peer = peer
        self.offset_ns = -time.time_ns() + 10_000 * NS
        self._clock = peer.node.create_publisher(Clock, "/clock", 10)
        arguments = ["-p", "robot:=panda", "-p", "use_sim_time:=true", "-p", f"state.timeout_s:={TIMEOUT_S}"]
        self.process = peer.start("node", folder, [*CALM, *arguments])
        self.arm = FakeArm(peer, make_robot("panda"), READY["panda"])
        self.goal = self.arm.pose()
        self.goal[2, 3] += 0.15
        peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), self.hold)
        self.move()

    def tick(self) -> None:
        now_ns = time.time_ns() + self.offset_ns
        self._clock.publish(Clock(clock=Time(sec=now_ns // NS, nanosec=now_ns % NS)))

    def hold(self) -> None:
        self.tick()
        self.arm()

    def follow(self) -> None:
        self.hold()
        self.peer.send_target(self.goal, "panda_link0")

    def move(self) -> None:
        """Until the arm moves, to the other of two targets."""
        self.goal[2, 3] += 0.15 if self.arm.pose()[2, 3] > self.goal[2, 3] - 0.05 else 0.0
        self.peer.until("motion", lambda: bool(np.abs(self.peer.commands[-1]).max() > 0.05), self.follow)

    def time_to_zeros(self, each: Callable[[], None] | None = None) -> float:
        """Seconds until zeros after the last joint state."""
        begin_s = time.monotonic()
        self.peer.until("zeros", lambda: not self.peer.commands[-1].any(), each)
        self.peer.until("the reason", lambda: self.peer.reason.startswith(SILENCES), each)
        return time.monotonic() - begin_s


@pytest.fixture
def simulated(tmp_path: Path) -> Iterator[SimulatedTime]:
    with peer_in_own_domain() as peer:
        yield SimulatedTime(peer, tmp_path)


def test_a_simulator_that_dies_leaves_zeros_and_signals_end_the_node(simulated: SimulatedTime) -> None:
    assert simulated.time_to_zeros() < LONGEST_S
    assert simulated.process.stop(signal.SIGINT, ENOUGH_S) == 0
    assert not simulated.peer.commands[-1].any()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_motion_with_zeros_while_the_clock_stands(simulated: SimulatedTime, number: int) -> None:
    assert simulated.process.stop(number, ENOUGH_S) == 0
    simulated.peer.until("zeros", lambda: not simulated.peer.commands[-1].any())


@pytest.mark.parametrize("jump_s", [-3600.0, -0.3, 3600.0])
def test_a_clock_that_jumps_does_not_delay_zeros(simulated: SimulatedTime, jump_s: float) -> None:
    simulated.offset_ns += round(jump_s * NS)
    simulated.peer.spin(0.3, simulated.follow)
    simulated.move()
    assert simulated.time_to_zeros(simulated.tick) < LONGEST_S

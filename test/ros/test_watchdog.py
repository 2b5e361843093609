"""The watchdog as a separate process: after a node is killed or hangs during a motion, no velocity command remains."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy
from waiting import ENOUGH_S

from ik_node.ros import qos

if rclpy:
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64MultiArray
    from std_srvs.srv import SetBool
LONG_S = 2.0
"""Time-out of the watchdog where it must not stop the arm: longer than a hold-up of the machine."""


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def watchdog_states(peer: Peer) -> list[str]:
    """What the node's diagnostics say of the watchdog, growing."""
    states: list[str] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        states.extend(entry.value for status in message.status for entry in status.values if entry.key == "watchdog")

    peer.node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, qos.OUTPUT)
    return states


def ready(peer: Peer, arm: FakeArm) -> None:
    """Waits until the node knows its watchdog."""
    states = watchdog_states(peer)
    peer.until("the watchdog", lambda: states[-1:] == ["ready"], arm)


def moving(peer: Peer, folder: Path, timeout_s: float, arguments: Sequence[str] = ()) -> FakeArm:
    peer.start("watchdog", folder, ["-p", f"timeout_s:={timeout_s}"])
    peer.start("node", folder, ["-p", "robot:=panda", *CALM, *arguments])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    ready(peer, arm)
    goal = arm.pose()
    goal[2, 3] += 0.15

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.05), each)
    return arm


def last_zeros(peer: Peer) -> int:
    """Number of zero commands since the last command that was not zero."""
    return next(count for count, command in enumerate(reversed(peer.commands)) if command.any())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_hanging_node_leaves_zeros(peer: Peer, tmp_path: Path, number: int) -> None:
    arm = moving(peer, tmp_path, 0.1)
    os.kill(peer.processes[1].pid, number)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    peer.until_silent(each=arm)  # the watchdog stops publishing
    assert last_zeros(peer) <= 6
    if number == signal.SIGSTOP:
        os.kill(peer.processes[1].pid, signal.SIGCONT)


def test_a_node_that_continues_after_a_hang_commands_zeros_first(peer: Peer, tmp_path: Path) -> None:
    # Joint states that a busy machine delays must not stop the arm before the hang, which is longer than the time-out.
    arm = moving(peer, tmp_path, 0.1, ["-p", "state.timeout_s:=1.0"])
    os.kill(peer.processes[1].pid, signal.SIGSTOP)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    peer.until_silent(1.5, arm)
    count = len(peer.commands)
    os.kill(peer.processes[1].pid, signal.SIGCONT)
    peer.until("the reason", lambda: "the node was held up for" in " ".join(map(str, peer.statuses)), arm)
    peer.until("holding", lambda: peer.mode == "holding" and len(peer.commands) > count + 5, arm)
    late = [command for command in peer.commands[count:] if command.any()]
    assert not peer.commands[count].any()
    assert max((np.abs(command).max() for command in late), default=0.0) < 1e-3


def test_commands_of_others_are_left_alone(peer: Peer, tmp_path: Path) -> None:
    """Another commander that falls silent at a velocity, slower than the time-out, gets no zeros."""
    peer.start("watchdog", tmp_path, ["-p", "timeout_s:=0.05"])
    peer.start("node", tmp_path, ["-p", "robot:=panda", *CALM])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    ready(peer, arm)
    peer.call(SetBool, "/ik_node/pause", SetBool.Request(data=True), arm)
    peer.until_silent(each=arm)
    other = peer.node.create_publisher(Float64MultiArray, "/ik_node/commands", qos.COMMAND)
    peer.until("the other commander", lambda: other.get_subscription_count() > 0)
    # On a busy machine the watchdog may have stopped the arm before.
    count, before = len(peer.commands), peer.processes[0].log.read_text()
    for _ in range(3):
        other.publish(Float64MultiArray(data=[0.01] * 7))
        peer.spin(0.3)
    peer.until("the commands", lambda: len(peer.commands) >= count + 3)
    assert [command.any() for command in peer.commands[count:]] == [True] * 3
    assert "the arm was stopped" not in peer.processes[0].log.read_text().removeprefix(before)


def test_the_diagnostics_of_the_node_know_the_watchdog(peer: Peer, tmp_path: Path) -> None:
    peer.start("node", tmp_path, ["-p", "robot:=panda", *CALM])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    states = watchdog_states(peer)
    peer.until("no watchdog", lambda: states[-1:] == ["absent"], arm)
    watchdog = peer.start("watchdog", tmp_path)
    peer.until("a watchdog", lambda: states[-1:] == ["ready"], arm)
    assert "ready: zeros on /ik_node/commands after 0.1 s" in watchdog.log.read_text()
    os.kill(watchdog.pid, signal.SIGINT)
    watchdog.stop(signal.SIGTERM, ENOUGH_S)  # the second signal: it may hold the arm with small commands
    peer.until("no watchdog again", lambda: states[-1:] == ["absent"], arm)


def test_a_node_that_ends_in_good_order_is_left_alone(peer: Peer, tmp_path: Path) -> None:
    """The node's own zeros are the last commands."""
    arm = moving(peer, tmp_path, LONG_S)
    peer.processes[1].stop(signal.SIGTERM, ENOUGH_S)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    peer.until_silent(LONG_S + 0.5, arm)
    assert not peer.commands[-1].any()
    assert last_zeros(peer) <= 3
    assert "the arm was stopped" not in peer.processes[0].log.read_text()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_watchdog_monitors_until_the_arm_is_at_rest(peer: Peer, tmp_path: Path, number: int) -> None:
    """Ctrl-C reaches node and watchdog at the same time; the ramp of the node needs the watchdog as well."""
    arm = moving(peer, tmp_path, LONG_S)
    watchdog, node = peer.processes
    os.kill(watchdog.pid, number)
    os.kill(watchdog.pid, signal.SIGINT)  # an impatient user
    peer.until("the line", lambda: "ends when the commands are zero" in watchdog.log.read_text(), arm)
    assert peer.commands[-1].any() and watchdog.exit_code is None
    os.kill(node.pid, signal.SIGKILL)
    peer.until("the end of the watchdog", lambda: watchdog.exit_code is not None, arm)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    assert watchdog.exit_code == 0


def test_sigterm_after_another_signal_ends_the_watchdog_at_once(peer: Peer, tmp_path: Path) -> None:
    arm = moving(peer, tmp_path, LONG_S)
    watchdog = peer.processes[0]
    os.kill(watchdog.pid, signal.SIGINT)
    peer.until("the line", lambda: "ends when the commands are zero" in watchdog.log.read_text(), arm)
    os.kill(watchdog.pid, signal.SIGTERM)
    peer.until("the end of the watchdog", lambda: watchdog.exit_code is not None, arm)
    assert watchdog.exit_code == 0 and peer.commands[-1].any()

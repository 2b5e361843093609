"""The watchdog as a process of its own: a node that is killed or hangs in the middle of a motion leaves no velocity."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def moving(peer: Peer, folder: Path, timeout_s: float) -> FakeArm:
    peer.start("watchdog", folder, ["-p", f"timeout_s:={timeout_s}"])
    peer.start("node", folder, ["-p", "robot:=panda", *CALM])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    watching = "/ik_node/commands"
    peer.until("the watchdog", lambda: peer.node.count_publishers(watching) == 2, arm)
    goal = arm.pose()
    goal[2, 3] += 0.15

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.05), each)
    return arm


def last_zeros(peer: Peer) -> int:
    """How many zeros have come since the last command that was not zero."""
    return next(count for count, command in enumerate(reversed(peer.commands)) if command.any())


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_hanging_node_leaves_zeros(peer: Peer, tmp_path: Path, number: int) -> None:
    arm = moving(peer, tmp_path, 0.1)
    os.kill(peer.processes[1].pid, number)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    peer.until_silent(each=arm)  # it does not go on talking
    assert last_zeros(peer) <= 6
    if number == signal.SIGSTOP:
        os.kill(peer.processes[1].pid, signal.SIGCONT)


def test_a_node_that_ends_in_good_order_is_left_alone(peer: Peer, tmp_path: Path) -> None:
    """Its own zeros are the last ones. The time-out is one that no busy machine exceeds on the way there."""
    arm = moving(peer, tmp_path, 1.0)
    peer.processes[1].stop(signal.SIGTERM, 60.0)
    peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
    peer.until_silent(1.5, arm)
    assert not peer.commands[-1].any()
    assert last_zeros(peer) <= 3
    assert "the arm was stopped" not in peer.processes[0].log.read_text()

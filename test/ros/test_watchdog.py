"""The watchdog as a process of its own: a node that is killed or hangs in the middle of a motion leaves no velocity."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import FakeArm, Peer, peer_in_own_domain


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def moving(peer: Peer, folder: Path) -> FakeArm:
    peer.start("watchdog", folder)
    peer.start("node", folder, ["-p", "robot:=panda", "-p", "rate_hz:=200.0"])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), each=arm)
    watching = "/ik_node/commands"
    peer.until("the watchdog", lambda: peer.node.count_publishers(watching) == 2, each=arm)
    goal = arm.pose()
    goal[2, 3] += 0.15

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.05), each=each)
    peer.spin(0.2, each)
    assert peer.commands[-1].any()
    return arm


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_killed_or_hanging_node_leaves_zeros(peer: Peer, tmp_path: Path, number: int) -> None:
    arm = moving(peer, tmp_path)
    os.kill(peer.processes[1].pid, number)
    stopped_at = time.monotonic()
    peer.until("zeros", lambda: not peer.commands[-1].any(), 3.0, arm)
    assert time.monotonic() - stopped_at < 2.0
    count = len(peer.commands)
    peer.spin(0.5, arm)
    assert len(peer.commands) - count <= 6, "it does not go on talking"
    if number == signal.SIGSTOP:
        os.kill(peer.processes[1].pid, signal.SIGCONT)


def test_a_node_that_ends_in_good_order_is_left_alone(peer: Peer, tmp_path: Path) -> None:
    arm = moving(peer, tmp_path)
    peer.processes[1].stop(signal.SIGTERM)
    peer.spin(0.2, arm)
    count = len(peer.commands)
    assert not peer.commands[-1].any()
    peer.spin(0.5, arm)
    assert len(peer.commands) == count

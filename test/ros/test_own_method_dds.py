"""The node with a method of the user, over DDS: its time is in the log, a fault is in the status, the arm goes on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy

from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource

if rclpy:
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import SetParameters

SOURCE = """
from time import sleep

def late(robot, q):
    if 0.02 < abs(q[0]) < 0.2:
        sleep(0.1)
    return None, q

def wrong(robot, q):
    if 0.02 < abs(q[0]) < 0.2:
        return None, q[1:]
    return None, q
"""


@pytest.fixture
def peer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Peer]:
    (tmp_path / "method_of_a_user_dds.py").write_text(SOURCE)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    with peer_in_own_domain() as found:
        yield found


def select(peer: Peer, method: str, each: FakeArm) -> tuple[bool, str]:
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=method)
    request = SetParameters.Request(parameters=[Parameter(name="method", value=value)])
    result = peer.call(SetParameters, "/ik_node/set_parameters", request, each).results[0]
    return result.successful, result.reason


@pytest.mark.parametrize(("name", "words"), [("wrong", "grad_h has the shape (6,)"), ("late", "a call took")])
def test_a_method_that_fails_is_replaced_and_the_arm_goes_on(peer: Peer, tmp_path: Path, name: str, words: str) -> None:
    """The recording gives the same bits, whether the function fails by itself or its time is measured."""
    method = f"method_of_a_user_dds:{name}"
    arguments = ["-p", "robot:=panda", "-p", f"extra_methods:=['{method}']", "-p", "recording.enabled:=true"]
    process = peer.start("node", tmp_path, [*CALM, *arguments, "-p", f"recording.directory:={tmp_path / 'bag'}"])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    accepted, reason = select(peer, "own_method_samples:gravity", arm)
    assert not accepted
    assert "was not loaded at the start" in reason
    assert select(peer, method, arm) == (True, "")
    goal = arm.pose()
    goal[1, 3] += 0.1

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("the reason", lambda: words in peer.reason and "continued with plain" in peer.reason, each)
    peer.until("arrival", lambda: bool(np.abs(arm.pose() - goal).max() < 1e-3), each)
    peer.until("control", lambda: peer.mode == "tracking", each)
    process.stop()
    log = process.log.read_text()
    assert "ms per call" in log
    assert words in log
    assert replay(RecordingSource(tmp_path / "bag")).identical
    assert load_run(tmp_path / "bag").settings["extra_methods"] == (method,)

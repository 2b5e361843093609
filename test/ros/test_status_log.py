"""Every warning and error of the status is in the log, once; a flood gives few lines."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy

from ik_node.interfaces.step import Level, Mode, Status
from ik_node.ros import qos
from ik_node.ros.status_log import BURST, PERIOD_S, REPEAT_S, StatusLog

if rclpy:
    from sensor_msgs.msg import JointState

PANDA = make_robot("panda")


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Lines(list[tuple[Level, str]]):
    def write(self, level: Level, line: str) -> None:
        self.append((level, line))


def warning(text: str, level: Level = Level.WARN) -> Status:
    return Status(level, Mode.HOLDING, text)


def test_a_status_is_logged_when_it_changes_and_again_after_a_while() -> None:
    lines, clock = Lines(), Clock()
    log = StatusLog(lines.write, clock)
    fine = Status(Level.OK, Mode.HOLDING, "no target yet")
    for _ in range(3):
        for status in (fine, warning("slow"), warning("slow"), warning("stopped", Level.ERROR)):
            log.add(status)
    assert lines == [(Level.WARN, "holding: slow"), (Level.ERROR, "holding: stopped")]
    clock.now_s += REPEAT_S
    log.add(fine)
    log.add(warning("slow"))
    assert lines[2:] == [(Level.WARN, "holding: slow")]


def test_a_flood_of_texts_gives_few_lines_and_the_last_one_is_not_lost() -> None:
    lines, clock = Lines(), Clock()
    log = StatusLog(lines.write, clock)
    for number in range(1000):
        log.add(warning(f"frame {number}"))
    assert len(lines) == BURST
    for _ in range(100):
        clock.now_s += PERIOD_S / 50.0
        log.add(warning("frame 999"))
    assert [line for _, line in lines[int(BURST) :]] == ["holding: frame 999"]
    for number in range(1000, 2000):
        clock.now_s += PERIOD_S / 100.0
        log.add(warning(f"frame {number}"))
    assert len(lines) <= BURST + 1 + 12


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def test_reasons_of_warnings_are_in_status_and_log(peer: Peer, tmp_path: Path) -> None:
    """An ignored joint state, targets in an unknown frame and out of reach, and the end of an arm's commands."""
    process = peer.start("node", tmp_path, [*CALM, "-p", "robot:=panda"])
    arm = FakeArm(peer, PANDA, READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding", arm)

    def reported(words: str) -> bool:
        return any(words in reason for _, reason in peer.statuses) and words in process.log.read_text()

    def outlier() -> None:
        peer.send_state(PANDA.joints, arm.position + np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]))

    peer.until("the outlier", lambda: reported("joint state ignored: joint 'panda_joint4' jumped"), arm, outlier)
    far = arm.pose()
    far[0, 3] += 3.0
    peer.until("holding", lambda: peer.mode == "holding", arm)
    peer.until("unknown frame", lambda: reported("unknown frame 'nose'"), arm, lambda: peer.send_target(far, "nose"))
    peer.until("reach", lambda: reported("out of reach"), arm, lambda: peer.send_target(far, "panda_link0"))


def test_publishers_that_contradict_each_other_are_counted(peer: Peer, tmp_path: Path) -> None:
    process = peer.start("node", tmp_path, [*CALM, "-p", "robot:=panda"])
    arm = FakeArm(peer, PANDA, READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding", arm)
    second = peer.node.create_publisher(JointState, "/joint_states", qos.OUTPUT)
    count = 0

    def both() -> None:
        nonlocal count
        arm()
        count += 1
        if count % 3 == 0:
            message = JointState(name=list(PANDA.joints), position=(arm.position + 1.0).tolist())
            message.header.stamp = peer.node.get_clock().now().to_msg()
            second.publish(message)

    words = "2 publishers on joint_states contradict each other"
    peer.until("the number of publishers", lambda: words in peer.reason, both)
    assert peer.mode in ("stopped", "waiting")
    assert "joint states contradict each other" in peer.reason
    assert "is there a second publisher?" in peer.reason
    peer.until("the log", lambda: words in process.log.read_text(), both)
    peer.node.destroy_publisher(second)
    peer.until("control without the second", lambda: peer.mode == "holding" and words not in peer.reason, arm)

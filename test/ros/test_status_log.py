"""Every warning and error of the status is in the log, once; a flood gives few lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy

from ik_node.control.joint_states import CONTRADICTION_S
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.ros import qos
from ik_node.ros.status_log import BURST, PERIOD_S, REPEAT_S, StatusLog

if rclpy:
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

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
    told = [(Level.OK, "holding: no target yet"), (Level.WARN, "holding: slow"), (Level.ERROR, "holding: stopped")]
    assert lines == told
    clock.now_s += REPEAT_S
    log.add(fine)
    log.add(warning("slow"))
    assert lines[3:] == [(Level.WARN, "holding: slow")]


def test_every_change_of_state_is_one_line() -> None:
    lines, clock = Lines(), Clock()
    log = StatusLog(lines.write, clock)
    for mode, text in (
        (Mode.WAITING, "waiting for the first joint state"),
        (Mode.HOLDING, "no target yet"),
        (Mode.TRACKING, "following target_pose"),
        (Mode.TRACKING, "following target_pose; slowed down by joint limits"),
        (Mode.TRACKING, "following target_pose"),
        (Mode.TRACKING, "following target_path"),
        (Mode.HOLDING, "no target yet"),
        (Mode.TRACKING, "following target_path"),
    ):
        for _ in range(3):
            log.add(Status(Level.WARN if ";" in text else Level.OK, mode, text))
    assert [line for _, line in lines] == [
        "waiting: waiting for the first joint state",
        "holding: no target yet",
        "tracking: following target_pose",
        "tracking: following target_pose; slowed down by joint limits",
        "tracking: following target_path",
        "holding: no target yet",
        "tracking: following target_path",
    ]


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

    # Two outliers within CONTRADICTION_S are a second source, which is another text and stops the arm.
    ignored = "joint state ignored: joint 'panda_joint4' jumped"
    peer.until("the outlier", lambda: reported(ignored), arm, outlier, 3.0 * CONTRADICTION_S)
    far = arm.pose()
    far[0, 3] += 3.0
    peer.until("holding", lambda: peer.mode == "holding", arm)
    peer.until("unknown frame", lambda: reported("unknown frame 'nose'"), arm, lambda: peer.send_target(far, "nose"))
    peer.until("reach", lambda: reported("out of reach"), arm, lambda: peer.send_target(far, "panda_link0"))


def test_the_log_begins_with_what_is_waited_for_and_names_changes(peer: Peer, tmp_path: Path) -> None:
    """From the start without a robot to a motion, and a change of parameters."""
    process = peer.start("node", tmp_path, [*CALM, "-p", "tip_frame:=panda_hand_tcp"])

    def said(words: str) -> Callable[[], bool]:
        return lambda: words in process.log.read_text()

    peer.until("the first line", said("waiting for robot_description on /robot_description"))
    publisher = peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
    publisher.publish(String(data=PANDA.urdf))
    peer.until("the description", said("waiting: waiting for the first joint state"))
    arm = FakeArm(peer, PANDA, READY["panda"])
    peer.until("holding", said("holding: no target yet"), arm)
    goal = arm.pose()
    goal[2, 3] += 0.02
    peer.until("tracking", said("tracking: following target_pose"), arm, lambda: peer.send_target(goal, "panda_link0"))
    change = SetParameters.Request(parameters=[Parameter("gain", value=[5.0, 4.0]).to_parameter_msg()])
    peer.call(SetParameters, "/ik_node/set_parameters", change, arm)
    peer.until("the change", said("parameters changed: gain [10.0, 10.0] -> [5.0, 4.0]"), arm)
    first = next(line for line in process.log.read_text().splitlines() if "[ik_node]" in line)
    assert "waiting for robot_description" in first


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

"""Descriptions on the topic: a broken one leaves the node alive, another one while it runs is reported and ignored."""

from __future__ import annotations

from pathlib import Path

import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, peer_in_own_domain, rclpy

from ik_node.robot import catalogue
from ik_node.ros import qos

if rclpy:
    from std_msgs.msg import String

PANDA = make_robot("panda")
URDF = catalogue.read_urdf(catalogue.find("panda"))
LOOP = '<joint name="a" type="fixed"><parent link="panda_link7"/><child link="panda_link2"/></joint></robot>'
BROKEN = (
    (URDF.replace("</robot>", LOOP), "link 'panda_link2' has two parents: joints "),
    (URDF.replace("</robot>", ""), "not XML: "),
)


def test_broken_descriptions_leave_the_node_alive_and_a_good_one_is_taken(tmp_path: Path) -> None:
    with peer_in_own_domain() as peer:
        process = peer.start("node", tmp_path, [*CALM, "-p", "tip_frame:=panda_link8"])
        publisher = peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
        for urdf, reason in BROKEN:
            publisher.publish(String(data=urdf))
            peer.until(reason, lambda words=reason: words in process.log.read_text())  # type: ignore[misc]
            peer.until(reason, lambda words=reason: words in peer.reason)  # type: ignore[misc]
            assert peer.mode == "waiting"
            assert peer.reason.startswith("not configured: ")
        publisher.publish(String(data=URDF))
        arm = FakeArm(peer, PANDA, READY["panda"])
        peer.until("holding", lambda: peer.mode == "holding", each=arm)
        assert process.exit_code is None


@pytest.mark.parametrize("by_parameter", [True, False])
def test_another_description_is_reported_and_ignored(tmp_path: Path, by_parameter: bool) -> None:
    with peer_in_own_domain() as peer:
        chosen = ["-p", "robot:=panda"] if by_parameter else ["-p", "tip_frame:=panda_hand_tcp"]
        process = peer.start("node", tmp_path, [*CALM, *chosen])
        publisher = peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
        publisher.publish(String(data=URDF))
        arm = FakeArm(peer, PANDA, READY["panda"])
        peer.until("holding", lambda: peer.mode == "holding", each=arm)
        assert "another robot_description" not in peer.reason
        for urdf in (BROKEN[0][0], URDF.replace("panda_hand", "hand")):
            publisher.publish(String(data=urdf))
            peer.until("the warning", lambda: "another robot_description was published" in peer.reason, each=arm)
            # A busy machine may stop the arm for lack of joint states in between.
            peer.until("control", lambda: peer.mode == "holding", each=arm)
            publisher.publish(String(data=URDF))
            peer.until("the end of it", lambda: "another robot_description" not in peer.reason, each=arm)
        assert "another robot_description was published" in process.log.read_text()
        assert process.exit_code is None

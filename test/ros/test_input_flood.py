"""Each input at and beyond its bound, as fast as one publisher can: the commands go on and a pause is answered.

The longest silence of the commands is printed per input. ``--exhaustive`` drives each input for a minute.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy

from ik_node.collision.scene import MAX_OBSTACLES
from ik_node.interfaces.samples import MAX_POSES
from ik_node.math import se3
from ik_node.ros import qos

if rclpy:
    from geometry_msgs.msg import Point, PoseStamped
    from nav_msgs.msg import Path as PathMessage
    from rclpy.serialization import serialize_message
    from std_srvs.srv import SetBool
    from visualization_msgs.msg import Marker, MarkerArray

PERIOD_S = 0.001
"""Inputs are sent at 1 kHz, or as fast as this process can."""
LONGEST_S = 2.0
"""Silence that fails the test on a busy machine; on an idle one a tenth of it is much. It was endless before."""
FRAME = "panda_link0"


def markers(count: int, lines: int = 0, action: int = 0) -> bytes:
    """``count`` spheres 2 m away, or line lists of ``lines`` points."""
    message = MarkerArray()
    for index in range(count):
        marker = Marker(ns="flood", id=index, type=Marker.LINE_LIST if lines else Marker.SPHERE, action=action)
        marker.header.frame_id = FRAME
        marker.scale.x = marker.scale.y = marker.scale.z = 0.05
        marker.pose.position.x, marker.pose.position.z = 2.0, 0.02 * index
        marker.points = [Point()] * lines
        message.markers.append(marker)
    return bytes(serialize_message(message))


def path(count: int, arm: FakeArm) -> bytes:
    """A circle of 2 cm about the tool."""
    message, start = PathMessage(), arm.pose()
    message.header.frame_id = FRAME
    turn = se3.quaternion_from_rotation(start[:3, :3]).tolist()
    for angle in np.linspace(0.0, 2.0 * np.pi, count):
        stamped = PoseStamped()
        p, q = stamped.pose.position, stamped.pose.orientation
        p.x, p.y, p.z = (start[:3, 3] + 0.02 * np.array([np.cos(angle), np.sin(angle), 0.0])).tolist()
        q.x, q.y, q.z, q.w = turn
        message.poses.append(stamped)
    return bytes(serialize_message(message))


def far_pose(frame: str) -> bytes:
    message = PoseStamped()
    message.header.frame_id = frame
    message.pose.position.x, message.pose.orientation.w = 1e160, 1.0
    return bytes(serialize_message(message))


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def test_no_input_silences_the_commands(
    peer: Peer, tmp_path: Path, pytestconfig: pytest.Config, capsys: pytest.CaptureFixture[str]
) -> None:
    peer.start("node", tmp_path, [*CALM, "-p", "robot:=panda"])
    arm = FakeArm(peer, make_robot("panda"), READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    floods = {
        f"{MAX_OBSTACLES} spheres": ("obstacles", MarkerArray, markers(MAX_OBSTACLES), "following|holding|no target"),
        "256 spheres": ("obstacles", MarkerArray, markers(256), f"there are {MAX_OBSTACLES} obstacles already"),
        "256 line lists": ("obstacles", MarkerArray, markers(256, 100), "LINE_LIST"),
        "3000 spheres": ("obstacles", MarkerArray, markers(3000), "3000 markers; at most 256"),
        "10000 spheres": ("obstacles", MarkerArray, markers(10_000), "10000 markers; at most 256"),
        f"{MAX_POSES} poses": ("target_path", PathMessage, path(MAX_POSES, arm), "target_path"),
        "100000 poses": ("target_path", PathMessage, path(100_000, arm), "100000 poses; at most 2000"),
        "far poses": ("target_pose", PoseStamped, far_pose(FRAME), "more than 100 m away"),
        "long frame": ("target_pose", PoseStamped, far_pose("f" * 100_000), "bytes; at most"),
    }
    duration_s = 60.0 if pytestconfig.getoption("--exhaustive") else 1.0
    rows = []
    for name, (topic, kind, data, expected) in floods.items():
        publisher = peer.node.create_publisher(kind, f"/ik_node/{topic}", qos.OUTPUT)
        peer.until(f"a subscriber of {topic}", lambda: publisher.get_subscription_count() > 0, arm)  # noqa: B023
        period_s = max(PERIOD_S, len(data) / 20e6)
        longest_s, sent, count, last_s = 0.0, 0, len(peer.commands), time.monotonic()
        end_s, next_s, before = last_s + duration_s, last_s, len(peer.statuses)
        while (now_s := time.monotonic()) < end_s:
            if now_s >= next_s:
                publisher.publish(data)
                sent, next_s = sent + 1, now_s + period_s
            peer.spin(PERIOD_S, arm)
            if len(peer.commands) > count:
                count, last_s = len(peer.commands), time.monotonic()
            longest_s = max(longest_s, time.monotonic() - last_s)
        asked_s = time.monotonic()
        assert peer.call(SetBool, "/ik_node/pause", SetBool.Request(data=True), arm).success
        rows.append(f"{name:16} {sent:6} sent  silence {longest_s:6.3f} s  pause {time.monotonic() - asked_s:6.3f} s")
        assert longest_s < LONGEST_S, "\n".join(rows)
        reasons = [reason for _, reason in peer.statuses[before - 1 :]]
        assert any(part in reason for part in expected.split("|") for reason in reasons), (name, reasons[-3:])
        assert all(np.isfinite(command).all() for command in peer.commands)
        assert peer.call(SetBool, "/ik_node/pause", SetBool.Request(data=False), arm).success
        peer.node.destroy_publisher(publisher)
        peer.until("holding", lambda: peer.mode in ("holding", "tracking"), arm)
    with capsys.disabled():
        print("\n" + "\n".join(rows))

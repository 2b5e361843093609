"""Over DDS: an arm whose driver publishes at controller_manager's default of 100 Hz moves with the default ``rate_hz``,
and a warning in the log names both rates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from loop import READY, make_robot
from ros_peer import peer_in_own_domain
from sensor_msgs.msg import JointState

from ik_node.ros import qos

DRIVER_HZ = 100.0
START = "[" + ", ".join(map(str, READY["panda"])) + "]"


def test_control_follows_a_driver_at_100_hz_and_the_log_names_both_rates(tmp_path: Path) -> None:
    robot = make_robot("panda")
    received: list[JointState] = []
    with peer_in_own_domain() as peer:
        peer.node.create_subscription(JointState, "joint_states", received.append, qos.STREAM)
        driver = ["-p", "robot:=panda", "-p", f"rate_hz:={DRIVER_HZ}", "-p", f"initial_position:={START}"]
        peer.start("simulator", tmp_path, driver)
        # A busy machine makes joint states late; this test is about their rate.
        node = peer.start("node", tmp_path, ["-p", "robot:=panda", "-p", "state.timeout_s:=5.0"])
        peer.until("control", lambda: peer.mode == "holding")

        def position() -> np.ndarray:
            state = received[-1]
            return np.array([state.position[state.name.index(joint)] for joint in robot.joints])

        peer.until("the warning", lambda: "joint states arrive at" in node.log.read_text())
        goal = robot.pose(position())
        goal[:3, 3] += (0.0, 0.05, 0.03)

        def distance() -> float:
            return float(np.linalg.norm(robot.pose(position())[:3, 3] - goal[:3, 3]))

        peer.until("the goal", lambda: distance() < 1e-3, now_and_then=lambda: peer.send_target(goal, robot.base_frame))
        warning = next(line for line in node.log.read_text().splitlines() if "joint states arrive at" in line)
        assert "[WARN]" in warning
        measured_hz = float(warning.partition("arrive at ")[2].partition(" Hz")[0])
        assert abs(measured_hz - DRIVER_HZ) < 0.15 * DRIVER_HZ
        assert "rate_hz is 500: control follows them" in warning

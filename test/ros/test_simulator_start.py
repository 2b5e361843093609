"""``ik_simulator`` without a configured start, over DDS: the chosen posture, and the same in the log."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from loop import make_robot
from ros_peer import peer_in_own_domain
from sensor_msgs.msg import JointState

from ik_node.control.start_posture import choose_start_posture
from ik_node.ros import qos


def test_the_simulator_starts_where_the_arm_can_move(tmp_path: Path) -> None:
    robot = make_robot("xarm7")
    chosen = choose_start_posture(robot)
    received: list[JointState] = []
    with peer_in_own_domain() as peer:
        peer.node.create_subscription(JointState, "joint_states", received.append, qos.STREAM)
        simulator = peer.start("simulator", tmp_path, ["-p", "robot:=xarm7"])
        peer.until("joint states", lambda: bool(received))
        said = simulator.log.read_text()
    state = received[0]
    position = np.array([state.position[state.name.index(joint)] for joint in robot.joints])
    assert np.abs(position - chosen.position).max() < 1e-12
    assert chosen.describe(robot.joints) in said

"""Late and lost targets, late steps and hold-ups of a node over DDS: in the status, in /diagnostics, and in the report.

SIGSTOP holds the node up; targets are left out. How often the machine itself holds up the node is not known, so the
figures are compared with each other and with lower bounds.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
from loop import READY, make_robot
from ros_peer import peer_in_own_domain, rclpy

from ik_node.control.late_inputs import GAP, HELD, HELD_UP
from ik_node.recording.run_reader import load_run
from ik_node.report import compute_metrics

if rclpy:
    from diagnostic_msgs.msg import DiagnosticArray

TARGET_PERIOD_S = 0.05
HOLD_UPS = 5
COUNTS = ("hold_ups", "targets", "targets_late", "targets_lost")


def test_what_comes_late_is_stated_by_the_node_and_by_its_recording(tmp_path: Path) -> None:
    robot = make_robot("panda")
    bag = tmp_path / "bag"
    settings = ("robot:=panda", "rate_hz:=100.0", "state.timeout_s:=5.0", "follow.enabled:=false")
    record = ("recording.enabled:=true", f"recording.directory:={bag}")
    with peer_in_own_domain() as peer:
        node = peer.start("node", tmp_path, [part for value in (*settings, *record) for part in ("-p", value)])
        figures: list[dict[str, str]] = []
        peer.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda message: figures.append({entry.key: entry.value for entry in message.status[0].values}),
            10,
        )
        pose, next_s, sends = robot.pose(np.array(READY["panda"])), 0.0, True

        def each() -> None:
            nonlocal next_s
            peer.send_state(robot.joints, READY["panda"])
            if sends and time.monotonic() >= next_s:
                next_s = time.monotonic() + TARGET_PERIOD_S
                peer.send_target(pose, robot.base_frame)

        def reported(text: str) -> bool:
            return any(text in reason for _, reason in peer.statuses)

        peer.until("tracking", lambda: peer.mode == "tracking", each)

        def hold_up() -> None:
            os.kill(node.pid, signal.SIGSTOP)
            time.sleep(0.15)  # the length of the hold-up; a process that is stopped has no condition to wait for
            os.kill(node.pid, signal.SIGCONT)
            peer.spin(0.3, each)

        peer.until("hold-ups", lambda: bool(figures) and int(figures[-1].get("hold_ups", 0)) >= HOLD_UPS, each, hold_up)
        peer.until("the cause of a held command", lambda: reported(f"{HELD}: {HELD_UP}"), each)

        def leave_out() -> None:
            nonlocal sends
            sends = False
            peer.spin(0.3, each)
            sends = True

        peer.until("the cause of a gap", lambda: reported(f"{GAP}: targets are late or lost"), each, leave_out)
        peer.until("figures", lambda: bool(figures) and int(figures[-1].get("targets_lost", 0)) > 2, each)
        published = figures[-1]
        node.stop(signal.SIGINT, 30.0)
    metrics = compute_metrics(load_run(bag))
    counted = {
        "hold_ups": metrics.late_steps.hold_ups,
        "targets": metrics.targets,
        "targets_late": metrics.late_targets.late,
        "targets_lost": metrics.late_targets.lost,
    }
    for name in COUNTS:
        assert counted[name] >= int(published[name]), (name, counted, published)
    assert int(published["hold_ups"]) >= HOLD_UPS
    assert metrics.late_steps.hold_up_max_ms > 140.0
    assert metrics.late_targets.age.max_ms > 200.0
    assert metrics.late_steps.by_machine >= HOLD_UPS

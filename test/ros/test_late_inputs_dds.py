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
from waiting import ENOUGH_S

from ik_node.control.late_inputs import GAP, HELD, HELD_UP
from ik_node.recording.run_reader import load_run
from ik_node.report import compute_metrics

if rclpy:
    from diagnostic_msgs.msg import DiagnosticArray

TARGET_PERIOD_S = 0.02
SHORTEST_S, LONGER_BY_S, LONGEST_S = 0.15, 0.02, 0.4
"""Each hold-up and each gap in the targets is longer than the one before: on a slow machine the test sends joint states
and targets at a lower rate, and of these a time has to be several periods."""
HOLD_UPS = 5
COUNTS = ("hold_ups", "targets", "targets_late", "targets_lost")


class Lengths:
    """Lengths of hold-ups or gaps, s."""

    def __init__(self) -> None:
        self.made = 0
        """Number of those that the node has met in closed loop."""
        self.next_s = SHORTEST_S

    def add(self, is_met: bool) -> None:
        """One has ended."""
        self.made += is_met
        self.next_s = min(self.next_s + LONGER_BY_S, LONGEST_S)


def test_what_comes_late_is_stated_by_the_node_and_by_its_recording(tmp_path: Path) -> None:
    robot = make_robot("panda")
    bag = tmp_path / "bag"
    # Hold-ups and gaps neither end the stream of targets nor stop the arm. A machine that is too slow stops it for 2 s:
    # then a new stream begins, as in the recording, where the targets of that time do not count as lost.
    settings = ("robot:=panda", "rate_hz:=100.0", "state.timeout_s:=10.0", "target.timeout_s:=1.0")
    record = ("follow.enabled:=false", "recording.enabled:=true", f"recording.directory:={bag}")
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

        def figure(name: str) -> int:
            return int(figures[-1].get(name, 0)) if figures else 0

        peer.until("tracking", lambda: peer.mode == "tracking", each)
        # A busy machine holds up the node as well, so those of the test are counted.
        held_up, left_out = Lengths(), Lengths()

        def hold_up() -> None:
            if peer.mode != "tracking":  # stopped, because the machine is too slow: it recovers without hold-ups
                return
            os.kill(node.pid, signal.SIGSTOP)
            time.sleep(held_up.next_s)  # a process that is stopped has no condition to wait for
            os.kill(node.pid, signal.SIGCONT)
            peer.spin(0.3, each)
            held_up.add(peer.mode == "tracking")

        def hold_ups_are_stated() -> bool:
            is_counted = min(held_up.made, figure("hold_ups")) >= HOLD_UPS
            return is_counted and reported(f"{HELD}: {HELD_UP}")

        peer.until("hold-ups and their effect", hold_ups_are_stated, each, hold_up, 0.5)

        def leave_out() -> None:
            nonlocal sends
            sends = False
            peer.spin(left_out.next_s, each)
            sends = True
            peer.spin(0.3, each)
            left_out.add(peer.mode == "tracking")

        def gaps_are_stated() -> bool:
            # Also repeated while the machine holds up the node in each gap, which is stated as the cause then.
            is_counted = left_out.made > 0 and figure("targets_lost") > 2
            return is_counted and reported(f"{GAP}: targets are late or lost")

        peer.until("gaps and their cause", gaps_are_stated, each, leave_out, 0.1)
        published = figures[-1]
        assert node.stop(signal.SIGINT, ENOUGH_S) == 0
    metrics = compute_metrics(load_run(bag))
    counted = {
        "hold_ups": metrics.late_steps.hold_ups,
        "targets": metrics.targets,
        "targets_late": metrics.late_targets.late,
        "targets_lost": metrics.late_targets.lost,
    }
    for name in COUNTS:
        assert counted[name] >= int(published[name]), (name, counted, published)
    assert metrics.late_steps.hold_up_max_ms > 0.9e3 * SHORTEST_S
    assert metrics.late_targets.age.max_ms > 0.9e3 * SHORTEST_S
    assert metrics.late_steps.by_machine >= HOLD_UPS

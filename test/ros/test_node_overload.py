"""A node that is starved, over DDS: it stops once with the machine as the reason, and starts again when it is better.

SIGSTOP and SIGCONT in turn take the processor from the node, as a machine does that is busy with something else. The
driver is a process of its own, so that its rate does not depend on the test. The figures of the node are printed.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from loop import READY, make_robot
from ros_peer import Peer, peer_in_own_domain, rclpy

if rclpy:
    from diagnostic_msgs.msg import DiagnosticArray

RATE_HZ = 200.0
NODE = ["-p", "robot:=panda", "-p", f"rate_hz:={RATE_HZ}", "-p", "state.timeout_s:=5.0", "-p", "follow.enabled:=false"]
"""Silences of some 0.1 s are not reported as such with this time-out."""
MACHINE = re.compile(r"this machine makes fewer than \d+ control steps per second, 0\.3 of ")
DRIVER_RATE = re.compile(r"joint states arrive slower than \d+ Hz, 0\.3 of ")
"""Reasons of a stop; the rate is less than 0.3 of ``rate_hz`` on a machine on which the driver is slower."""
ATTEMPTS = 10
"""The driver is slowed down again when the machine was slow at the same time, which is another reason."""
DRIVER = """
import sys, time, rclpy
from pathlib import Path
from rclpy.node import Node
from sensor_msgs.msg import JointState
from ik_node.ros import qos
rclpy.init()
node = Node("driver")
publisher = node.create_publisher(JointState, "/joint_states", qos.OUTPUT)
message = JointState(name=sys.argv[2].split(","), position=[float(text) for text in sys.argv[3].split(",")])
next_s = time.monotonic()
while True:
    period_s = 1.0 / float(Path(sys.argv[1]).read_text())
    message.header.stamp = node.get_clock().now().to_msg()
    publisher.publish(message)
    next_s = max(next_s + period_s, time.monotonic())
    time.sleep(max(next_s - time.monotonic(), 0.0))
"""


class Driver:
    """Publishes the joint states of an arm that stands."""

    def __init__(self, peer: Peer, rate_file: Path) -> None:
        self._rate_file = rate_file
        self.set_rate(RATE_HZ)
        robot = make_robot("panda")
        names, position = ",".join(robot.joints), ",".join(map(str, READY["panda"]))
        environment = {**os.environ, "ROS_DOMAIN_ID": str(peer.domain)}
        command = [sys.executable, "-c", DRIVER, str(rate_file), names, position]
        self._process = subprocess.Popen(command, env=environment)

    def set_rate(self, rate_hz: float) -> None:
        """The process stays: a new one would begin with a silence, as long as the machine takes for its imports."""
        written = self._rate_file.with_suffix(".new")
        written.write_text(str(rate_hz))
        written.replace(self._rate_file)  # never seen empty

    def stop(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


@pytest.fixture
def driver(peer: Peer, tmp_path: Path) -> Iterator[Driver]:
    made = Driver(peer, tmp_path / "rate_hz")
    yield made
    made.stop()


class Figures:
    """The newest figures of the node in /diagnostics."""

    def __init__(self, peer: Peer) -> None:
        self.values: dict[str, str] = {}
        peer.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.values = {entry.key: entry.value for entry in message.status[0].values}

    def __str__(self) -> str:
        names = ("joint_states_hz", "steps_hz", "clock_calls_hz", "steps_late")
        return "  ".join(f"{name} {self.values.get(name, '-'):>5}" for name in names)


def stops(peer: Peer, since: int) -> int:
    """Number of changes to ``stopped`` in the statuses since one."""
    modes = [mode for mode, _ in peer.statuses[since:]]
    return sum(now == "stopped" != before for before, now in zip(["", *modes], modes, strict=False))


def test_a_starved_node_stops_once_and_a_slow_driver_is_named(
    peer: Peer, driver: Driver, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    node = peer.start("node", tmp_path, NODE)
    figures, rows = Figures(peer), []
    peer.until("control", lambda: peer.mode == "holding" and "this machine" not in peer.reason)
    peer.spin(2.5)
    rows.append(f"plain           {figures}")

    def starve(run_s: float, stop_s: float) -> Callable[[], None]:
        """The node runs for ``run_s`` and is stopped for ``stop_s``, in turn."""

        def once() -> None:
            os.kill(node.pid, signal.SIGSTOP)
            time.sleep(stop_s)
            os.kill(node.pid, signal.SIGCONT)
            time.sleep(run_s)

        return once

    begin = len(peer.statuses)
    peer.until("the stop", lambda: peer.mode == "stopped", starve(0.02, 0.4))
    assert MACHINE.match(peer.reason)
    end_s = time.monotonic() + 6.0
    peer.until("six seconds", lambda: time.monotonic() > end_s, starve(0.02, 0.4))
    rows.append(f"starved         {figures}  stops {stops(peer, begin)}")
    assert peer.mode == "stopped"
    assert stops(peer, begin) == 1
    peer.until("the restart", lambda: peer.mode == "holding")
    for _ in range(ATTEMPTS):
        begin = len(peer.statuses)
        driver.set_rate(0.1 * RATE_HZ)
        peer.until("the stop", lambda: peer.mode == "stopped")
        reason, end_s = peer.reason, time.monotonic() + 4.0
        peer.until("four seconds", lambda: time.monotonic() > end_s)  # noqa: B023 - called at once
        rows.append(f"slow driver     {figures}  stops {stops(peer, begin)}")
        assert stops(peer, begin) == 1
        driver.set_rate(RATE_HZ)
        peer.until("the restart", lambda: peer.mode == "holding")
        if DRIVER_RATE.match(reason):
            break
        assert MACHINE.match(reason)
    else:
        pytest.fail(f"the machine was too slow {ATTEMPTS} times")
    with capsys.disabled():
        print("\n" + "\n".join(rows))
    log = node.log.read_text()
    assert re.search(f"stopped: {MACHINE.pattern}", log)

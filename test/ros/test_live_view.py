"""The viewer of a running node shows the data of the node and the simulated arm, received over DDS.

test_viewer.py tests the page; these tests check that the page is served, that its frames are correct, and the error for
a node that does not exist.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from loop import READY
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from ros_peer import CALM, Peer, peer_in_own_domain

from ik_node.errors import IkNodeError
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.resources import config_file
from ik_node.robot.catalogue import robot_from_settings
from ik_node.ros.live_view.listener import LiveViewListener
from ik_node.ros.live_view.live_timeline import LiveTimeline
from ik_node.settings.groups import ArmSettings, Settings


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as made:
        yield made


def start_panda(peer: Peer, folder: Path) -> None:
    """A simulated panda at 100 Hz and the node that drives it."""
    # In this order: rcl merges all -p arguments at the place of the first one, and the last value wins.
    file, rate = ["--params-file", str(config_file("panda.yaml"))], ["-p", "rate_hz:=100.0"]
    peer.start("simulator", folder, [*file, *rate])
    peer.start("node", folder, [*file, *CALM, *rate])


def test_live_timeline_agrees_with_node_and_arm(peer: Peer, tmp_path: Path) -> None:
    """Settings of the node; pose, error and status of a moving arm; distance of the closest pair."""
    start_panda(peer, tmp_path)
    watcher = LiveViewListener("/ik_node", peer.context)
    peer.executor.add_node(watcher)
    peer.until("the node to hold", lambda: peer.mode == "holding")
    robot = robot_from_settings(ArmSettings(robot="panda"))

    timeline = LiveTimeline(watcher, robot, watcher_settings(peer, watcher), capacity=1000)
    times = iter(0.01 * np.arange(1, 100000))

    def sample() -> None:
        timeline.sample(float(next(times)))

    peer.until("joint states", lambda: timeline.has_joint_state, sample)
    start = robot.pose(timeline.buffer.timeline().joint_position[-1])
    target = start.copy()
    target[:3, 3] += (0.0, 0.04, 0.0)

    def follow() -> None:
        peer.send_target(target, robot.base_frame)
        sample()

    peer.until(
        "the arm to move", lambda: bool(timeline.buffer.timeline().pose_sb[-1, 1, 3] > start[1, 3] + 0.03), follow
    )
    recorded = timeline.buffer.timeline()
    moving = next(row for row in range(len(recorded.times_s)) if recorded.status[row].mode is Mode.TRACKING)
    # The first frames may be older than the first status.
    assert Mode.HOLDING in {status.mode for status in recorded.status[:moving]}
    assert np.abs(recorded.joint_velocity[moving:]).max() > 0.05
    assert recorded.sigma_min[-1] == pytest.approx(0.16, abs=0.05)
    last = len(recorded.times_s) - 1
    assert recorded.pose_sb[last] == pytest.approx(robot.pose(recorded.joint_position[last]))
    assert timeline.targets[-1] == pytest.approx(target[:3, 3])
    assert 0.0 < recorded.clearance[last] < 0.5
    assert len(recorded.closest_pair[last]) == 2


def test_displayed_error_agrees_with_displayed_poses(peer: Peer, tmp_path: Path) -> None:
    """For an arm that does not execute commands, so that all displayed values are constant."""
    peer.start("node", tmp_path, ["-p", "robot:=panda", *CALM, "-p", "rate_hz:=100.0"])
    robot = robot_from_settings(ArmSettings(robot="panda"))
    q = np.array(READY["panda"])
    target = robot.pose(q)
    target[:3, 3] += (0.0, 0.04, 0.01)
    watcher = LiveViewListener("/ik_node", peer.context)
    peer.executor.add_node(watcher)
    timeline = LiveTimeline(watcher, robot, Settings().with_values({"obstacles.geometry": "none"}), capacity=1000)
    times = iter(0.01 * np.arange(1, 1000000))

    def each() -> None:
        peer.send_state(robot.joints, q)
        peer.send_target(target, robot.base_frame)
        timeline.sample(float(next(times)))

    def agree() -> bool:
        recorded = timeline.buffer.timeline()
        if not len(recorded.times_s) or not np.isfinite(recorded.error_b[-1]).all():
            return False
        expected = se3.log(se3.inverse(recorded.pose_sb[-1]) @ recorded.pose_sd[-1])
        return bool(np.linalg.norm(expected[:3]) > 0.02 and np.abs(recorded.error_b[-1] - expected).max() < 1e-6)

    peer.until("poses and error of a standing arm", agree, each)


def test_the_tolerance_of_the_task_is_that_of_the_node(peer: Peer, tmp_path: Path) -> None:
    spin = ("-p", "task.tolerance:=[0.0, 0.0, 0.0, 0.0, 0.0, .inf]", "-p", "task.frame:=base")
    peer.start("node", tmp_path, ["-p", "robot:=panda", *CALM, "-p", "rate_hz:=100.0", *spin])
    watcher = LiveViewListener("/ik_node", peer.context)
    peer.executor.add_node(watcher)
    task = watcher_settings(peer, watcher).task
    assert (task.tolerance, task.frame) == ((0.0, 0.0, 0.0, 0.0, 0.0, float("inf")), "base")
    timeline = LiveTimeline(watcher, robot_from_settings(ArmSettings(robot="panda")), Settings(task=task), 100)
    timeline.sample(1.0)
    wanted = (0.0, 0.0, 0.0, 0.2, 0.2, float("inf"))
    change = Parameter("task.tolerance", Parameter.Type.DOUBLE_ARRAY, wanted).to_parameter_msg()
    answer = peer.call(SetParameters, "/ik_node/set_parameters", SetParameters.Request(parameters=[change]))
    assert answer.results[0].successful
    peer.until("the change", lambda: timeline.tolerance_at(9.0).half_widths == wanted, lambda: timeline.sample(2.0))
    assert timeline.tolerance_at(2.0).frame == "base"
    assert timeline.tolerance_at(1.0).half_widths == task.tolerance


def watcher_settings(peer: Peer, watcher: LiveViewListener) -> Settings:
    """Requested in a separate thread, as in the viewer, while the peer's executor spins."""
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(watcher.request_settings, 100.0)
        peer.until("the settings", asked.done)
        settings = asked.result()
        assert settings.arm.robot == "panda"
        assert settings.control.rate_hz == 100.0
        nobody = pool.submit(LiveViewListener("/nobody", peer.context).request_settings, 0.2)
        peer.until("no answer", nobody.done)
        with pytest.raises(IkNodeError, match=r"no node '/nobody' answers; nodes here: .*/ik_node"):
            nobody.result()
        return settings


def test_live_page_from_the_command_line(peer: Peer, tmp_path: Path) -> None:
    """Serves a page of the running node until a signal ends it."""
    start_panda(peer, tmp_path)
    peer.until("the node to hold", lambda: peer.mode == "holding")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(peer.domain)}
    command = [sys.executable, "-m", "ik_node.cli.view", "--live", "--port", "0"]
    output = tmp_path / "view.log"
    with output.open("w") as log:
        viewer = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
    try:
        peer.until("the page", lambda: "http://" in output.read_text())
        address = re.search(r"http://localhost:(\d+)", output.read_text())
        assert address is not None
        with urllib.request.urlopen(f"http://127.0.0.1:{address[1]}/") as answer:
            assert b"<html" in answer.read(2000)
        viewer.send_signal(signal.SIGTERM)
        assert viewer.wait(120.0) == 0, output.read_text()
    finally:
        viewer.kill()
        viewer.wait()

"""The viewer on a running node: what it shows is what the node and the simulated arm say, over DDS.

The page itself is tested in test_view.py; here it is enough that it is served, that the moments behind it are right,
and that whoever looks at a node that is not there is told so.
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
from ros_peer import Peer, peer_in_own_domain

from ik_node.errors import IkNodeError
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.resources import config_file
from ik_node.robot.catalogue import robot_from
from ik_node.ros.live_view.listener import ViewNode
from ik_node.ros.live_view.live_timeline import LiveFilm
from ik_node.settings.groups import ArmSettings, Settings


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as made:
        yield made


def start_panda(peer: Peer, folder: Path) -> None:
    """A simulated panda at 100 Hz and the node that drives it."""
    arguments = ["--params-file", str(config_file("panda.yaml")), "-p", "rate_hz:=100.0"]
    peer.start("simulator", folder, [*arguments, "-r", "commands:=/ik_node/commands"])
    peer.start("node", folder, arguments)


def test_live_film_shows_what_node_and_arm_say(peer: Peer, tmp_path: Path) -> None:
    """Settings as the node has them; pose, error and state of a moving arm; obstacles and their distance."""
    start_panda(peer, tmp_path)
    watcher = ViewNode("/ik_node", peer.context)
    peer.executor.add_node(watcher)
    peer.until("the node to hold", lambda: peer.mode == "holding")
    robot = robot_from(ArmSettings(robot="panda"))

    film = LiveFilm(watcher, robot, watcher_settings(peer, watcher), capacity=1000)
    times = iter(0.01 * np.arange(1, 100000))

    def shoot() -> None:
        film.shoot(float(next(times)))

    peer.until("joint states", lambda: film.placed, each=shoot)
    start = robot.pose(film.reel.film().q[-1])
    target = start.copy()
    target[:3, 3] += (0.0, 0.04, 0.0)

    def follow() -> None:
        peer.send_target(target, robot.base_frame)
        shoot()

    peer.until("the arm to move", lambda: bool(film.reel.film().pose_sb[-1, 1, 3] > start[1, 3] + 0.03), each=follow)
    seen = film.reel.film()
    moving = next(row for row in range(len(seen.times_s)) if seen.status[row].mode is Mode.TRACKING)
    assert seen.status[0].mode is Mode.HOLDING
    assert np.abs(seen.joint_velocity[moving:]).max() > 0.05
    assert seen.sigma_min[-1] == pytest.approx(0.16, abs=0.05)
    last = len(seen.times_s) - 1
    assert seen.pose_sb[last] == pytest.approx(robot.pose(seen.q[last]))
    assert seen.error_b[last] == pytest.approx(se3.log(se3.inverse(seen.pose_sb[last]) @ seen.pose_sd[last]), abs=0.01)
    assert film.targets[-1] == pytest.approx(target[:3, 3])
    assert 0.0 < seen.clearance[last] < 0.5
    assert len(seen.closest_pair[last]) == 2


def watcher_settings(peer: Peer, watcher: ViewNode) -> Settings:
    """Asked for in a thread of its own, as the viewer does; the peer's executor spins meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(watcher.ask_settings, 15.0)
        peer.until("the settings", asked.done, timeout_s=30.0)
        settings = asked.result()
        assert settings.arm.robot == "panda"
        assert settings.control.rate_hz == 100.0
        nobody = pool.submit(ViewNode("/nobody", peer.context).ask_settings, 0.2)
        peer.until("no answer", nobody.done)
        with pytest.raises(IkNodeError, match=r"no node '/nobody' answers; nodes here: .*/ik_node"):
            nobody.result()
        return settings


def test_live_page_from_the_command_line(peer: Peer, tmp_path: Path) -> None:
    """It serves a page of the running node and ends with a signal."""
    start_panda(peer, tmp_path)
    peer.until("the node to hold", lambda: peer.mode == "holding")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(peer.domain)}
    command = [sys.executable, "-m", "ik_node.cli.view", "--live", "--port", "0"]
    said = tmp_path / "view.log"
    with said.open("w") as log:
        viewer = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
    try:
        peer.until("the page", lambda: "http://" in said.read_text(), timeout_s=40.0)
        address = re.search(r"http://localhost:(\d+)", said.read_text())
        assert address is not None
        with urllib.request.urlopen(f"http://127.0.0.1:{address[1]}/") as answer:
            assert b"<html" in answer.read(2000)
        viewer.send_signal(signal.SIGTERM)
        assert viewer.wait(15.0) == 0, said.read_text()
    finally:
        viewer.kill()
        viewer.wait()

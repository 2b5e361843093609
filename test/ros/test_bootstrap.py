"""``bootstrap.py ik_node`` as a process of its own: a signal to that process while the arm moves ends with zeros."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, peer_in_own_domain
from support import PROJECT, loaded_program


def is_set_up() -> bool:
    """Whether bootstrap.py would start the node without installing anything."""
    bootstrap = loaded_program(PROJECT / "bootstrap.py")
    return all(path.is_file() for path in (bootstrap.VENV / "installed-1", bootstrap.BIN / "ik_node"))


@pytest.mark.skipif(not is_set_up(), reason="needs the .venv that bootstrap.py makes in this checkout")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_bootstrap_ends_a_motion_with_zeros(tmp_path: Path, number: int) -> None:
    with peer_in_own_domain() as peer, (tmp_path / "log").open("wb") as log:
        slow = ["-p", "robot:=panda", "-p", "limits.acceleration:=[0.2]"]
        process = subprocess.Popen(
            [sys.executable, str(PROJECT / "bootstrap.py"), "ik_node", "--ros-args", *CALM, *slow],
            env={**os.environ, "ROS_DOMAIN_ID": str(peer.domain)},
            stdout=log,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            arm = FakeArm(peer, make_robot("panda"), READY["panda"])
            peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
            goal = arm.pose()
            goal[2, 3] += 0.15

            def follow() -> None:
                arm()
                peer.send_target(goal, "panda_link0")

            peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.15), follow)
            process.send_signal(number)
            peer.until("the end", lambda: process.poll() is not None, arm)
            assert process.returncode == 0
            peer.until("zeros", lambda: not peer.commands[-1].any(), arm)
        finally:
            process.kill()
            process.wait()

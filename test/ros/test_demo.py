"""The main job in one command, as a user starts it: processes, DDS, recording, report.

Figures are those that the README promises, with an ideal arm at 500 Hz; machines that run tests are noisy, so these
bounds are wide against what is measured on a quiet one.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from ros_peer import FakeArm, peer_in_own_domain
from support import shared_path

from ik_node.math.se3 import pose_from
from ik_node.messages.decode import decode_joint_state, decode_pose
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.run_reader import load_run
from ik_node.robot import catalogue
from ik_node.settings.groups import ArmSettings

LONGEST_PERIOD_MS = 30.0
"""Between two ticks; the usual time-out of joint states is 100."""


def start(out: Path, *arguments: str) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != "ROS_DOMAIN_ID"}
    command = [sys.executable, "-m", "ik_node.cli.demo", "--headless", "--out", str(out), *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)


def demo(out: Path, *arguments: str) -> tuple[dict[str, dict[str, dict[str, float]]], str]:
    """Report and printed text of a demonstration that goes to its end."""
    process = start(out, *arguments)
    said, _ = process.communicate(timeout=150)
    assert process.returncode == 0, said
    return json.loads((out / "report.json").read_text()), said


def undisturbed_demo(out: Path, *arguments: str) -> tuple[Path, dict[str, dict[str, dict[str, float]]], str]:
    """The same, once more where the machine held the processes up for so long that figures say nothing of the node."""
    for attempt in range(3):
        folder = out.with_name(f"{out.name}_{attempt}")
        report, said = demo(folder, *arguments)
        if report["ticks"]["period_max_ms"] < LONGEST_PERIOD_MS:  # type: ignore[operator]
            break
    return folder, report, said


def assert_safe(out: Path) -> None:
    run = load_run(out / "bag")
    assert np.isfinite(run.joint_velocity).all()
    assert (np.abs(run.joint_velocity) <= run.velocity_limits).all()
    assert run.complete
    assert run.dropped == 0


@pytest.fixture(scope="module")
def panda_run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    out, report, said = undisturbed_demo(tmp_path_factory.mktemp("demo") / "panda")
    settled = report["tracking"]["settled"]
    assert settled["position_rms_mm"] < 2.0, said
    assert settled["orientation_rms_mrad"] < 4.0, said
    yield out


def test_the_default_demonstration_tracks_records_and_reports(panda_run: Path) -> None:
    assert_safe(panda_run)
    picture = (panda_run / "report.png").read_bytes()
    assert picture.startswith(b"\x89PNG")
    assert len(picture) > 50_000
    lines = (panda_run / "trajectory.csv").read_text().splitlines()
    assert len(lines) > 4000


def test_the_recording_opens_elsewhere(panda_run: Path) -> None:
    anyreader = pytest.importorskip("rosbags.highlevel").AnyReader
    with anyreader([panda_run / "bag"]) as reader:
        commands = [c for c in reader.connections if c.topic == "/ik_node/commands"]
        count = sum(1 for _ in reader.messages(connections=commands))
        last = [reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(connections=commands)][-1]
    assert count > 4500
    assert not last.data.any()
    read_ros2_messages = pytest.importorskip("mcap_ros2.reader").read_ros2_messages
    file = next((panda_run / "bag").glob("*.mcap"))
    read = [m.ros_msg.data for m in read_ros2_messages(str(file), topics=["/ik_node/commands"])]
    assert len(read) == count


def test_a_recording_feeds_a_fresh_node(panda_run: Path, tmp_path: Path) -> None:
    """Its joint states and targets, published again, make a fresh node command nearly what was recorded."""
    run = load_run(panda_run / "bag")
    robot = catalogue.robot_from(ArmSettings(robot="panda"))
    messages = Recording(panda_run / "bag").messages({"/joint_states", "/ik_node/target_pose"})
    with peer_in_own_domain() as peer:
        peer.start("node", tmp_path, ["-p", "robot:=panda"])
        arm = FakeArm(peer, robot, run.q[0].tolist())
        peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), each=arm)
        peer.commands.clear()
        begin_ns, begin_s = None, time.monotonic()
        for message in messages:
            begin_ns = message.log_time_ns if begin_ns is None else begin_ns
            due_s = (message.log_time_ns - begin_ns) * 1e-9
            if due_s > 4.0:
                break
            while time.monotonic() - begin_s < due_s:
                peer.spin(0.001)
            if message.topic == "/joint_states":
                state = decode_joint_state(message.data)
                peer.send_state(state.names, state.position)
            else:
                target = decode_pose(message.data)
                peer.send_target(pose_from(target.position, target.quaternion), target.frame_id)
        peer.spin(0.05)
        recorded = run.joint_velocity[run.times_s < 4.0]
        assert len(peer.commands) > 0.8 * len(recorded)
        # Not the peaks: where the machine held one of both up, it had to catch up.
        usual = np.percentile(np.abs(recorded), 80, axis=0)
        again = np.percentile(np.abs(np.array(peer.commands)), 80, axis=0)
        assert usual.max() > 0.1
        assert np.abs(again - usual).max() < 0.2 * usual.max()


def test_the_demonstration_of_another_arm_at_another_rate(tmp_path: Path) -> None:
    arguments = ("--robot", "ur5", "--target-rate", "500", "--rate", "250", "--method", "inertia_weighted")
    out, report, said = undisturbed_demo(tmp_path / "ur5", *arguments)
    assert report["tracking"]["settled"]["position_rms_mm"] < 1.0, said
    assert report["tracking"]["settled"]["orientation_rms_mrad"] < 3.0, said
    assert_safe(out)
    run = load_run(out / "bag")
    assert (run.robot, run.settings["rate_hz"], run.settings["method"]) == ("ur5", 250.0, "inertia_weighted")
    assert np.median(np.diff(run.times_s)) > 0.003


def test_ctrl_c_ends_it_with_a_whole_recording_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "cut"
    process = start(out)
    deadline = time.monotonic() + 30
    while not (out / "bag").exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    time.sleep(3.0)
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert (out / "report.png").exists()
    assert_safe(out)
    run = load_run(out / "bag")
    assert 1.0 < run.times_s[-1] < 8.0
    assert not run.joint_velocity[-1].any()


def test_an_existing_folder_and_an_unknown_trajectory_are_refused(tmp_path: Path) -> None:
    for arguments, words in (
        ((), "exists already"),
        (("--trajectory", "spiral", "--out", str(tmp_path / "new")), "spiral"),
    ):
        process = start(tmp_path, *arguments)
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 1
        assert words in said
        assert "Traceback" not in said


def test_a_singular_demonstration_of_a_real_hand_stays_within_its_limits(tmp_path: Path) -> None:
    path = shared_path("data", "robottasks", "openbox.npy")
    report, said = demo(tmp_path / "box", "--trajectory", str(path), "--units", "cm", "--order", "wxyz")
    assert_safe(tmp_path / "box")
    assert report["tracking"]["settled"]["position_rms_mm"] < 2.0, said
    assert "lost there" in said, "passes a singularity, and says what it cost"

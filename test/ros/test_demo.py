"""The demonstration in one command, as a user starts it: processes, DDS, recording, report.

The figures are those in the README, for an ideal arm at 500 Hz. They are computed from the recorded input in simulated
time, so that the timing of the machine has no influence.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from domains import own_domain
from loop import Loop
from ros_peer import CALM, FakeArm, peer_in_own_domain
from support import shared_path

from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.math.se3 import pose_from
from ik_node.messages.decode import decode_joint_state
from ik_node.messages.decode_targets import decode_pose
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.text import as_text
from ik_node.report.ground_truth import GROUND_TRUTH_FILE, GroundTruth, read_ground_truth
from ik_node.robot import catalogue
from ik_node.settings.groups import ArmSettings

PATIENT = ("--set", "state.timeout_s=10.0", "--set", "follow.enabled=false")
"""The state machine tolerates a busy machine; test_controller.py tests its time-outs."""
PATIENCE_S = 600.0
POSITION, TURN = slice(0, 3), slice(3, 6)


@contextmanager
def started(out: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    with own_domain() as domain:
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
        command = [sys.executable, "-m", "ik_node.cli.demo", "--headless", "--out", str(out), *arguments]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        try:
            yield process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.communicate(timeout=PATIENCE_S)


def demo(out: Path, *arguments: str) -> tuple[dict[str, dict[str, dict[str, float]]], str]:
    """Return report and printed text of a complete demonstration."""
    with started(out, *PATIENT, *arguments) as process:
        said, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, said
    return json.loads((out / "report.json").read_text()), said


def errors_in_simulated_time(bag: Path, truth: GroundTruth) -> tuple[float, float]:
    """Return RMS errors of position, mm, and orientation, mrad, of an arm that receives the targets at their stamps.

    The received targets are on the trajectory; those that a busy machine lost are taken from it.
    """
    source, targets = RecordingSource(bag), load_run(bag).targets
    frame = targets.frame_ids[0]
    assert set(targets.frame_ids) == {frame}
    approach = targets.stamp_ns < truth.ros_ns[0]
    arrived = targets.stamp_ns[~approach]
    on_the_way = truth.at(arrived)
    assert np.abs(targets.position[~approach] - on_the_way.position).max() < 1e-4
    turned = (targets.quaternion_xyzw[~approach] * on_the_way.quaternion).sum(axis=1)
    assert np.abs(turned).min() > 1.0 - 1e-6
    grid = np.arange(truth.ros_ns[0], truth.ros_ns[-1], np.diff(arrived).min())
    stamps = [*targets.stamp_ns[approach].tolist(), *grid.tolist()]
    wanted = truth.at(grid)
    places = np.vstack((targets.position[approach], wanted.position))
    quaternions = np.vstack((targets.quaternion_xyzw[approach], wanted.quaternion))

    loop = Loop(source.robot(), load_run(bag).q[0], source.initial_settings)
    loop.run(0.05)
    later_ns = loop.now.ros_ns - stamps[0]
    sent = 0

    def send() -> None:
        nonlocal sent
        while sent < len(stamps) and stamps[sent] + later_ns <= loop.now.ros_ns:
            loop.target(pose_from(places[sent], quaternions[sent]), stamps[sent] + later_ns, frame)
            sent += 1

    loop.run((stamps[-1] - stamps[0]) / NS, send)
    ros_ns = np.array([step.now.ros_ns for step in loop.steps]) - later_ns
    within = np.flatnonzero((ros_ns >= truth.ros_ns[0]) & (ros_ns <= truth.ros_ns[-1]))
    assert len(within) > 200
    wanted = truth.at(ros_ns[within])
    errors = [
        se3.log(se3.inverse(loop.steps[row].pose_sb) @ pose_from(*pose))
        for row, *pose in zip(within, wanted.position, wanted.quaternion, strict=True)
    ]
    position, orientation = (np.sqrt((np.array(errors)[:, part] ** 2).sum(axis=1).mean()) for part in (POSITION, TURN))
    return 1e3 * float(position), 1e3 * float(orientation)


def assert_same_bits(bag: Path) -> None:
    """Replay in a new process: distances depend, in their last digits, on the geometries that a process has built."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        pool.submit(check_replay, bag).result()


def check_replay(bag: Path) -> None:
    source = RecordingSource(bag)
    again = replay(source)
    assert again.passed, as_text(source, again, 1.0)


def assert_follows(out: Path, position_mm: float, orientation_mrad: float) -> None:
    """Check the tracking errors of a simulated arm for the streamed targets and the recorded settings.

    For the run itself, check that every command is the controller's response to its input and that the arm moved, but
    not its tracking error: where the machine suspends the node for half a second, the arm continues with an outdated
    command. test_node.py checks that a node moves an arm to its target, and waits for it.
    """
    truth = read_ground_truth(out / GROUND_TRUTH_FILE)
    position, orientation = errors_in_simulated_time(out / "bag", truth)
    assert position < position_mm, (position, orientation)
    assert orientation < orientation_mrad
    assert_same_bits(out / "bag")
    run = load_run(out / "bag")
    went = np.nanmax(run.pose_sb[:, :3, 3], axis=0) - np.nanmin(run.pose_sb[:, :3, 3], axis=0)
    assert went.max() > 0.5 * np.ptp(truth.position, axis=0).max()
    assert np.abs(run.joint_velocity).max() > 0.1


def assert_safe(out: Path) -> None:
    run = load_run(out / "bag")
    assert np.isfinite(run.joint_velocity).all()
    assert (np.abs(run.joint_velocity) <= run.velocity_limits).all()
    assert run.complete
    assert run.dropped == 0


@pytest.fixture(scope="module")
def panda_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demo") / "panda"
    report, said = demo(out)
    assert np.isfinite(report["tracking"]["settled"]["position_rms_mm"]), said
    return out


def test_the_default_demonstration_tracks_records_and_reports(panda_run: Path) -> None:
    assert_safe(panda_run)
    assert_follows(panda_run, 2.0, 4.0)
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
    assert count >= len(load_run(panda_run / "bag").times_s) > 1000
    assert not last.data.any()
    read_ros2_messages = pytest.importorskip("mcap_ros2.reader").read_ros2_messages
    file = next((panda_run / "bag").glob("*.mcap"))
    read = [m.ros_msg.data for m in read_ros2_messages(str(file), topics=["/ik_node/commands"])]
    assert len(read) == count


def test_a_recording_feeds_a_fresh_node(panda_run: Path, tmp_path: Path) -> None:
    """The joint states and targets of a recording are published in their order; a fresh node receives them unchanged
    and responds as the controller does."""
    old = load_run(panda_run / "bag")
    robot = catalogue.robot_from_settings(ArmSettings(robot="panda"))
    messages = Recording(panda_run / "bag").messages({"/joint_states", "/ik_node/target_pose"})
    with peer_in_own_domain() as peer:
        recording = ["-p", "recording.enabled:=true", "-p", f"recording.directory:={tmp_path / 'bag'}"]
        peer.start("node", tmp_path, ["-p", "robot:=panda", *CALM, *recording])
        arm = FakeArm(peer, robot, old.q[0].tolist())
        peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
        # A busy machine starts the streamer of the targets seconds after the recording.
        first_ns = next(message.log_time_ns for message in messages if message.topic.endswith("target_pose"))
        begin_ns, end_ns = first_ns - NS // 10, first_ns + 4 * NS
        states, targets = 0, 0
        for message in Recording(panda_run / "bag").messages({"/joint_states", "/ik_node/target_pose"}):
            if not begin_ns < message.log_time_ns < end_ns:
                continue
            if message.topic == "/joint_states":
                state = decode_joint_state(message.data)
                peer.send_state(state.names, state.position)
                states += 1
            else:
                target = decode_pose(message.data)
                peer.send_target(pose_from(target.position, target.quaternion), target.frame_id)
                targets += 1
            peer.spin(0.001)
        assert min(states, targets) > 50
        assert peer.processes[0].stop(signal.SIGINT, PATIENCE_S) == 0
    new = load_run(tmp_path / "bag")
    assert len(new.targets.position) > 0.5 * targets
    known = {row.tobytes() for row in old.targets.position}
    assert all(row.tobytes() in known for row in new.targets.position)
    known = {row.tobytes() for row in old.q}
    assert np.mean([row.tobytes() in known for row in new.q]) > 0.9
    assert any(change.status.mode is Mode.TRACKING for change in new.status_changes)
    assert np.abs(new.joint_velocity).max() > 0.1
    assert_same_bits(tmp_path / "bag")


def test_the_demonstration_of_another_arm_at_another_rate(tmp_path: Path) -> None:
    arguments = ("--robot", "ur5", "--target-rate", "500", "--rate", "250", "--method", "inertia_weighted")
    out = tmp_path / "ur5"
    demo(out, *arguments)
    assert_follows(out, 1.0, 3.0)
    assert_safe(out)
    run = load_run(out / "bag")
    assert (run.robot, run.settings["rate_hz"], run.settings["method"]) == ("ur5", 250.0, "inertia_weighted")
    assert len(run.times_s) < 300.0 * run.times_s[-1], "joint states have that rate or a lower one"


def test_ctrl_c_ends_it_with_a_whole_recording_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "cut"
    with started(out, *PATIENT) as process:
        assert process.stdout is not None
        # The first line about the motion is printed at its start, the second one two seconds later.
        said = ""
        while not re.search(r"^ +[1-9][\d.]* / .* error ", said, re.MULTILINE):
            line = process.stdout.readline()
            assert line, said
            said += line
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 130, said + rest
    assert (out / "report.png").exists()
    assert_safe(out)
    run = load_run(out / "bag")
    assert 10 < len(run.targets.times_s) < 500, "of the 501 targets of the whole trajectory"
    assert np.abs(run.joint_velocity).max() > 0.01
    assert not run.joint_velocity[-1].any()


def test_an_existing_folder_and_an_unknown_trajectory_are_refused(tmp_path: Path) -> None:
    for arguments, words in (
        ((), "exists already"),
        (("--trajectory", "spiral", "--out", str(tmp_path / "new")), "spiral"),
    ):
        with started(tmp_path, *arguments) as process:
            said, _ = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 2
        assert words in said
        assert "Traceback" not in said


def test_the_beginning_of_a_real_hand_s_demonstration_is_followed(tmp_path: Path) -> None:
    """A file of poses, at its own times, after an approach to its first pose."""
    whole = np.load(shared_path("data", "robottasks", "openbox.npy"))
    path, out = tmp_path / "openbox.npy", tmp_path / "box"
    np.save(path, whole[:, :100])
    _, said = demo(out, "--trajectory", str(path), "--units", "cm", "--order", "wxyz")
    assert_safe(out)
    assert_follows(out, 2.0, np.inf)
    assert "s approach to the first pose" in said


def test_an_arm_without_a_configuration_starts_where_it_can_move(tmp_path: Path) -> None:
    """Zeros are a singular start in self-collision; another one is chosen, and printed."""
    out = tmp_path / "tiago"
    _, said = demo(out, "--robot", "tiago_no_hand", "--trajectory", "line")
    assert_safe(out)
    assert_follows(out, 2.0, np.inf)
    assert "start posture chosen, none is configured: torso_lift_joint" in said
    assert load_run(out / "bag").singular_values[0, -1] > 0.1


@pytest.mark.exhaustive
def test_a_singular_demonstration_of_a_real_hand_stays_within_its_limits(tmp_path: Path) -> None:
    path = shared_path("data", "robottasks", "openbox.npy")
    out = tmp_path / "box"
    _, said = demo(out, "--trajectory", str(path), "--units", "cm", "--order", "wxyz")
    assert_safe(out)
    assert_follows(out, 2.0, np.inf)
    assert "lost there" in said, "passes a singularity and reports the lost time"

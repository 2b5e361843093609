"""Replay: the recorded calls to a new controller give the recorded Steps bit for bit, for recordings of the real node
over DDS and of the controller in one process, with every kind of call, from the start or from the middle. A difference
is reported with its step and field. Not tested here: the content of recordings (test_recording.py) and durations
(`ik_benchmark replay`)."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loop import Loop
from recorded_loop import RecordedCaller, finish, record, recorded_loop
from waiting import ENOUGH_S

from ik_node.control.controller import Controller
from ik_node.errors import TargetRefused
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.math import se3
from ik_node.messages.decode import decode_joint_state
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.writer import Recorder, RecorderOptions
from ik_node.replay.bitwise import Comparison, replay
from ik_node.replay.call_source import RecordingSource
from ik_node.robot.frames import transform_text
from ik_node.settings.method_names import METHOD_NAMES
from ik_node.trajectory.shapes import figure_of_eight


def replayed(directory: Path) -> Comparison:
    return replay(RecordingSource(directory))


def recorder(loop: Loop) -> RecordedCaller:
    controller: Any = loop.controller
    assert isinstance(controller, RecordedCaller)
    return controller


def follow(loop: Loop, duration_s: float = 1.0, rate_hz: float = 50.0) -> None:
    loop.follow(figure_of_eight(loop.pose()).pose, duration_s, rate_hz)


def assert_same(found: Comparison, loop: Loop) -> None:
    assert found.first is None
    assert found.passed
    assert found.environment_differences == ()
    assert found.steps == len(loop.steps)
    assert (found.missing_calls, found.missing_steps, found.skipped_calls) == (0, 0, 0)


# --- identical bits ---


@pytest.mark.parametrize("method", METHOD_NAMES)
@pytest.mark.parametrize("law", ["twist_feedback", "ik_difference"])
def test_every_method_and_law_comes_out_the_same(tmp_path: Path, method: str, law: str) -> None:
    loop = recorded_loop(tmp_path / "bag", {"method": method, "control_law": law, "rate_hz": 200.0})
    follow(loop)
    finish(loop)
    assert_same(replayed(tmp_path / "bag"), loop)


def eventful(loop: Loop) -> None:
    """Make a run with every kind of call and every reason to stop and to continue."""
    controller, robot = recorder(loop), loop.robot
    follow(loop, 0.6)
    controller.pause(loop.now, "paused by request")
    loop.run(0.3)
    controller.resume(loop.now)
    follow(loop, 0.4, 200.0)
    controller.apply(
        loop.controller.settings.with_values({"gain": (3.0, 10.0), "method": "gravity_gradient"}), loop.now
    )
    follow(loop, 0.4)
    with pytest.raises(TargetRefused):
        loop.target(np.eye(4), frame_id="nowhere")
    turned = (0.1, 0.2, 0.3, 0.0, 0.0, np.sin(0.3), np.cos(0.3))
    controller.on_transform(transform_text("camera", turned[:3], turned[3:]), loop.now)
    in_camera = se3.inverse(se3.pose_from(turned[:3], turned[3:])) @ loop.pose()
    loop.target(in_camera, frame_id="camera")
    controller.on_publishers("2 publishers on target_pose", loop.now)
    loop.run(0.1)
    controller.on_publishers("", loop.now)
    controller.on_input_note("target_path target_path refused: 3000 poses", loop.now)
    loop.run(0.1)
    controller.on_input_note("target_path ", loop.now)
    for _ in range(15):  # no messages
        loop.time_ns += 10_000_000
        loop.take(controller.on_clock(loop.now))
    loop.run(0.1)
    names, q = robot.joints, loop.position
    for part in (slice(0, 3), slice(3, None)):  # in two messages, each with a joint of another device
        loop.time_ns += NS // 1000
        loop.take(
            controller.on_joint_state(JointSample(0, (*names[part], "finger"), np.append(q[part], 1.0)), loop.now)
        )
    loop.take(controller.on_joint_state(JointSample(loop.now.ros_ns, names, np.full(robot.n, np.nan)), loop.now))
    controller.reset(loop.now)
    loop.run(0.1)
    follow(loop, 0.3)


def test_every_kind_of_call_comes_out_the_same(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 250.0})
    eventful(loop)
    finish(loop)
    assert_same(replayed(tmp_path / "bag"), loop)


def test_a_recording_that_begins_in_the_middle_comes_out_the_same(tmp_path: Path) -> None:
    """From every state: before the first joint state, moving, ramping, paused, without joint states, in a fault."""
    loop = recorded_loop(tmp_path / "first", {"rate_hz": 250.0})
    moments = 0

    def again() -> None:
        nonlocal moments
        finish(loop)
        assert_same_part(tmp_path / f"bag{moments}")
        moments += 1
        loop.controller = recorder(loop).controller
        record(loop, tmp_path / f"bag{moments}")

    def assert_same_part(directory: Path) -> None:
        if directory.exists():
            found = replayed(directory)
            assert found.first is None
            assert found.environment_differences == ()

    again()
    follow(loop, 0.3)
    again()
    follow(loop, 0.5)
    again()
    follow(loop, 0.5)
    recorder(loop).pause(loop.now, "paused by request")
    again()
    loop.run(0.3)
    again()
    recorder(loop).resume(loop.now)
    follow(loop, 0.3)
    again()
    recorder(loop).apply(loop.controller.settings.with_values({"control_law": "ik_difference"}), loop.now)
    follow(loop, 0.3)
    again()
    for _ in range(15):
        loop.time_ns += 10_000_000
        loop.take(recorder(loop).on_clock(loop.now))
    loop.run(0.1)
    again()
    assert moments == 8


def test_each_part_of_a_split_recording_comes_out_the_same_by_itself(tmp_path: Path) -> None:
    options = RecorderOptions(max_part_s=0.5, flush_period_s=0.02, compression="none")
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 250.0}, options=options)
    eventful(loop)
    finish(loop)
    whole = replayed(tmp_path / "bag")
    assert_same(whole, loop)
    parts = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(parts) == 5
    assert whole.snapshots == 2 * (len(parts) - 1), "at the end of each part and at the start of the next"
    alone = [replayed(part) for part in parts]
    assert all(found.first is None and found.missing_calls == 0 for found in alone)
    assert sum(found.steps for found in alone) == whole.steps


# --- differences and missing data ---


def changed(recorded: RecordingSource, number: int, **fields: Any) -> None:
    """Replace the recorded event of that number."""
    original = recorded.entries

    def entries() -> Any:
        for entry in original():
            hit = isinstance(entry, RecordedCall) and entry.number == number
            yield entry._replace(**fields) if isinstance(entry, RecordedCall) and hit else entry

    recorded.entries = entries  # type: ignore[method-assign]


def test_what_parts_is_named_with_its_tick_and_input(tmp_path: Path) -> None:
    """One measured joint position is changed by a picoradian: the difference is found at that input."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0})
    follow(loop)
    finish(loop)
    recorded = RecordingSource(tmp_path / "bag")
    event = [entry for entry in recorded.entries() if isinstance(entry, RecordedCall) and entry.step is not None][100]
    tick = recorded.steps.step(event.step or b"").tick
    data = bytearray(event.data)
    sample = decode_joint_state(event.data)
    place = event.data.index(sample.position.tobytes())
    data[place : place + 8] = (sample.position[:1] + 1e-12).tobytes()
    recorded = RecordingSource(tmp_path / "bag")
    changed(recorded, event.number, data=bytes(data))
    found = replay(recorded)
    assert found.first is not None
    assert not found.passed
    assert (found.first.tick, found.first.field) == (tick, "joint_position")
    assert found.first.source == f"on_joint_state, message {event.call.sequence} of joint_states"
    assert 0.0 < found.first.size < 1e-11
    assert 0.0 < found.max_difference["joint_velocity"] < 1e-9
    assert found.within_tolerance


def test_a_step_too_many_or_too_few_is_found(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0})
    follow(loop, 0.2)
    finish(loop)
    events = [entry for entry in RecordingSource(tmp_path / "bag").entries() if isinstance(entry, RecordedCall)]
    ticking = [entry for entry in events if entry.step is not None][20]
    for step, kind, recorded_as in ((None, ticking.call.kind, "none"), (ticking.step, CallKind.ON_CLOCK, "a Step")):
        recorded = RecordingSource(tmp_path / "bag")
        changed(recorded, ticking.number, step=step, call=ticking.call._replace(kind=kind))
        first = replay(recorded).first
        assert first is not None
        assert first.time_s == pytest.approx((ticking.call.now.monotonic_ns - events[0].call.now.monotonic_ns) / NS)
        assert (first.field, first.recorded) == ("step", recorded_as)


def test_other_settings_than_the_recorded_ones_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller that computes anything else is detected."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0})
    follow(loop, 0.5)
    finish(loop)
    recorded = RecordingSource(tmp_path / "bag")
    other = recorded.head.settings.with_values({"gain": (9.0, 10.0)})
    monkeypatch.setattr(recorded, "controller", lambda: Controller(recorded.robot(), other))
    found = replay(recorded)
    assert found.first is not None
    assert {"twist_b", "joint_velocity"} <= set(found.max_difference)
    assert "error_b" not in found.max_difference, "measured values are the recorded ones"
    assert not found.within_tolerance


def test_it_says_where_messages_were_lost_and_goes_on_at_the_next_state(tmp_path: Path) -> None:
    """After an overflow of the queue: calls before the loss and after the next recorded state are compared."""
    options = RecorderOptions(queue_mb=0.2, flush_period_s=0.6)
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0}, options=options)
    for _ in range(3):
        follow(loop, 0.6)
    loop.run(0.02)
    finish(loop)
    assert loop.controller.recording.dropped > 0  # type: ignore[attr-defined]
    found = replayed(tmp_path / "bag")
    assert found.first is None
    assert found.missing_calls + found.missing_steps > 0
    assert found.steps > 50
    assert found.steps + found.missing_steps + found.skipped_calls + found.missing_calls >= len(loop.steps)


def test_other_meshes_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Distances depend on mesh files that the recording does not contain: changed files are reported."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0})
    follow(loop, 0.2)
    finish(loop)
    recorded = RecordingSource(tmp_path / "bag")
    other = recorded.head.settings.with_values({"obstacles.geometry": "capsule"})
    monkeypatch.setattr(recorded, "controller", lambda: Controller(recorded.robot(), other))
    found = replay(recorded)
    assert any(line.startswith("collision geometry") for line in found.environment_differences)
    assert not found.passed


# --- the command line ---


def ik_replay(*arguments: str | Path, **environment: str) -> tuple[int, dict[str, Any], str]:
    """Return the exit code, the figures and the text on stderr."""
    command = [sys.executable, "-m", "ik_node.cli.replay", *map(str, arguments), "--json"]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=ENOUGH_S, check=False, env={**os.environ, **environment}
    )
    return done.returncode, json.loads(done.stdout) if done.stdout else {}, done.stderr


def test_the_command_says_which_of_the_two_held(tmp_path: Path) -> None:
    """Here the bits are identical. With BLAS kernels of another processor they differ, by rounding only."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0, "method": "gravity_gradient"})
    follow(loop)
    finish(loop)
    code, figures, _ = ik_replay(tmp_path / "bag")
    assert (code, figures["identical"], figures["max_difference"]) == (0, True, {})
    code, figures, _ = ik_replay(tmp_path / "bag", OPENBLAS_CORETYPE="Prescott")
    if any("Prescott" in line for line in figures["environment_differences"]):
        assert not figures["identical"]
        assert 0.0 < max(figures["max_difference"].values()) <= figures["tolerance"]
    assert (code, figures["passed"]) == (0, True)


def test_a_recording_that_parts_gives_exit_code_1(tmp_path: Path) -> None:
    """One bit of a recorded command is changed, in a file with valid checksums."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 200.0}, options=RecorderOptions(compression="none"))
    follow(loop, 0.5)
    finish(loop)
    file = tmp_path / "bag" / "bag_0.mcap"
    event = [e for e in RecordingSource(tmp_path / "bag").entries() if isinstance(e, RecordedCall) and e.step][50]
    other = bytearray(event.step or b"")
    other[-9] ^= 0x10
    data = file.read_bytes().replace(event.step or b"", bytes(other))[:-8]  # truncated: no index
    data = without_checksums(data)
    file.write_bytes(data)
    code, figures, said = ik_replay(file)
    assert code == 1, said
    assert not figures["passed"]
    assert figures["first"]["tick"] == 50


def without_checksums(data: bytes) -> bytes:
    """Return the chunks of an MCAP file with their checksums set to "none"."""
    changed_data, offset = bytearray(data), 8
    while offset + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        if opcode == 6:
            changed_data[offset + 9 + 24 : offset + 9 + 28] = bytes(4)
        offset += 9 + length
    return bytes(changed_data)


def test_what_cannot_be_replayed_gives_exit_code_2_and_a_reason(tmp_path: Path) -> None:
    code, _, said = ik_replay(tmp_path / "nothing")
    assert code == 2
    assert "does not exist" in said
    assert "Traceback" not in said
    Recorder(tmp_path / "empty").close()
    code, _, said = ik_replay(tmp_path / "empty")
    assert code == 2
    assert "it holds: nothing" in said


# --- the node ---


def test_a_run_of_the_node_comes_out_the_same(tmp_path: Path) -> None:
    """Real processes, DDS and real time: the replay has the recorded timing."""
    pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")
    out, poses = tmp_path / "run", tmp_path / "poses.csv"
    lines = [f"{0.02 * number},0,{0.05 * np.sin(0.06 * number)},0,0,0,0,1" for number in range(101)]
    poses.write_text("\n".join(["time,x,y,z,qx,qy,qz,qw", *lines]))
    command = [
        sys.executable,
        "-m",
        "ik_node.cli.demo",
        "--headless",
        "--out",
        str(out),
        "--method",
        "gravity_gradient",
        "--trajectory",
        str(poses),
        "--relative",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=ENOUGH_S, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    code, figures, said = ik_replay(out / "bag")
    assert code == 0, said
    assert figures["identical"], figures
    assert figures["missing"] == {"calls": 0, "skipped_calls": 0, "steps": 0}
    counts = {topic.name: count for topic, count in Recording(out / "bag").counts().items()}
    assert figures["steps"] == counts["/ik_node/step"] > 0

"""Transforms of tf at the stamp of a sample, of bounded age; tf is played by the test."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loop import READY, Loop, make_robot

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")

from ros_peer import CALM, FakeArm, peer_in_own_domain  # noqa: E402
from waiting import ENOUGH_S  # noqa: E402

from ik_node.interfaces.clock import Instant  # noqa: E402
from ik_node.interfaces.samples import PathSample, PoseSample, TrajectorySample, TwistSample  # noqa: E402
from ik_node.messages.step_codec import CallKind  # noqa: E402
from ik_node.recording.call_log import RecordedCall  # noqa: E402
from ik_node.replay.bitwise import replay  # noqa: E402
from ik_node.replay.call_source import RecordingSource  # noqa: E402
from ik_node.replay.recorded_controller import RecordedController  # noqa: E402
from ik_node.ros.transforms import TransformRefused, Transforms  # noqa: E402

S = 1_000_000_000


class Missing(Exception):
    pass


class Buffer:
    """Has transforms at whole seconds up to 10 s; x is the second."""

    static = False

    def lookup_transform(self, base: str, frame: str, time: Any) -> Any:
        if frame != "camera":
            raise Missing
        if time.nanoseconds > 10 * S:
            raise Missing
        seconds = time.nanoseconds // S or 10
        stamp = SimpleNamespace(sec=0 if self.static else seconds, nanosec=0)
        transform = SimpleNamespace(
            translation=SimpleNamespace(x=float(seconds), y=0.0, z=0.0),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return SimpleNamespace(header=SimpleNamespace(stamp=stamp), transform=transform)


def transforms(static: bool = False) -> Transforms:
    kind = type("Buffer", (Buffer,), {"static": static})
    module = SimpleNamespace(TransformException=Missing, Buffer=kind, TransformListener=lambda buffer, node: None)
    return Transforms(None, module)


def test_the_transform_at_the_stamp_is_taken_else_the_newest() -> None:
    tf = transforms()
    (at,) = tf.lookup("base", ["camera"], 9 * S, 9 * S + S // 4)
    assert at.startswith("camera 9.0 ")
    (newest,) = tf.lookup("base", ["camera"], 10 * S + S // 4, 10 * S + S // 4)
    assert newest.startswith("camera 10.0 ")
    assert list(tf.lookup("base", ["camera"], 0, 10 * S)) == [], "unchanged"
    assert list(tf.lookup("base", ["kitchen"], 0, 10 * S)) == []


PLACE, TURN, NONE = np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.empty((0, 6))
TIMES_NS = (20 * S,)
"""A time of a pose of a path lies ahead; its transform is wanted at the header stamp."""


def sample_of(kind: str, stamp_ns: int) -> object:
    if kind == "pose":
        return PoseSample(stamp_ns, "camera", PLACE[0], TURN[0])
    if kind == "path":
        return PathSample(("camera",), TIMES_NS, PLACE, TURN, stamp_ns)
    if kind == "trajectory":
        return TrajectorySample(stamp_ns, "camera", TIMES_NS, PLACE, TURN, NONE, NONE)
    return TwistSample(stamp_ns, "camera", np.zeros(6))


@pytest.mark.parametrize("kind", ["pose", "path", "trajectory", "twist"])
@pytest.mark.parametrize(("stamp_s", "taken_s"), [(9.8, 9.0), (10.2, 10.0), (0.0, 10.0), (12.0, 10.0)])
def test_every_target_is_placed_at_its_header_stamp(kind: str, stamp_s: float, taken_s: float) -> None:
    """A stamp ahead of tf, as of a trajectory that starts later, and no stamp: the newest transform."""
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.02)
    now = Instant(loop.now.monotonic_ns, 9 * S + S // 4 if taken_s == 9.0 else 10 * S + S // 4)
    calls = RecordedController(loop.controller)
    assert transforms().pass_frames(calls, sample_of(kind, round(stamp_s * S)), now)
    assert loop.controller.capture().frames.transforms["camera"][0, 3] == taken_s


@pytest.mark.parametrize("kind", ["pose", "path", "trajectory", "twist"])
def test_every_target_with_an_old_transform_is_refused(kind: str) -> None:
    loop = Loop(make_robot("panda"), READY["panda"])
    calls = RecordedController(loop.controller)
    with pytest.raises(TransformRefused, match=r"transform from camera to panda_link0 is older than 0\.5 s"):
        transforms().pass_frames(calls, sample_of(kind, 9 * S), Instant(S, 10 * S + S // 5))


def test_an_old_transform_is_refused() -> None:
    for stamp_ns in (0, 28 * S):
        with pytest.raises(TransformRefused, match=r"^transform from camera to base is older than 0\.5 s$"):
            list(transforms().lookup("base", ["camera"], stamp_ns, 28 * S + S // 5))


def test_a_static_transform_has_no_age() -> None:
    assert len(list(transforms(static=True).lookup("base", ["camera"], 0, 28 * S))) == 1


TF2_ROS = '''
from types import SimpleNamespace as Values
import time


class TransformException(Exception):
    pass


class TransformListener:
    def __init__(self, buffer, node):
        pass


class Buffer:
    """One transform, whose broadcaster has ended 10 s ago."""

    def lookup_transform(self, base, frame, when):
        if frame != "camera":
            raise TransformException
        transform = Values(translation=Values(x=0.0, y=0.0, z=0.0), rotation=Values(x=0.0, y=0.0, z=0.0, w=1.0))
        return Values(header=Values(stamp=Values(sec=int(time.time()) - 10, nanosec=0)), transform=transform)
'''


def test_a_refused_transform_is_in_status_log_and_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The note is a recorded call, so the replay has the same status."""
    (tmp_path / "tf2_ros.py").write_text(TF2_ROS)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path), os.environ.get("PYTHONPATH", ""))))
    bag = tmp_path / "bag"
    words = "target_pose refused: transform from camera to panda_link0 is older than 0.5 s"
    with peer_in_own_domain() as peer:
        recorded = ["-p", "recording.enabled:=true", "-p", f"recording.directory:={bag}"]
        process = peer.start("node", tmp_path, [*CALM, "-p", "robot:=panda", *recorded])
        arm = FakeArm(peer, make_robot("panda"), READY["panda"])
        peer.until("holding", lambda: peer.mode == "holding", arm)
        goal = arm.pose()
        peer.until("the refusal", lambda: words in peer.reason, arm, lambda: peer.send_target(goal, "camera"))
        peer.until("the log", lambda: words in process.log.read_text(), arm)
        peer.until("the end of it", lambda: words not in peer.reason, arm, lambda: peer.send_target(goal, ""))
        assert process.stop(signal.SIGINT, ENOUGH_S) == 0
    source = RecordingSource(bag)
    calls = [entry for entry in source.entries() if isinstance(entry, RecordedCall)]
    assert any(words.encode() in entry.data for entry in calls if entry.call.kind is CallKind.ON_INPUT_NOTE)
    assert replay(source).passed

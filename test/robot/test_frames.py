"""Frames outside the robot model: poses from tf, used by every input, part of the controller's snapshot.

tf2_ros is not on PyPI, so a stub with its three names replaces it below the node's own adapter. The controller is the
real one.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from loop import READY, Loop, make_robot

from ik_node.control.controller import Controller
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import InputError, TargetRefused
from ik_node.interfaces.samples import ObstacleSample, PathSample, PoseSample, TrajectorySample, TwistSample, frames_of
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.json_codec import from_json, to_json
from ik_node.robot.frames import Frames, transform_text
from ik_node.ros.transforms import Transforms

CAMERA = se3.exp(np.array([0.8, -0.2, 0.5, 0.3, -0.9, 1.7]))
NONE = np.zeros((0, 6))


def transform(pose: Array) -> str:
    return transform_text("camera", pose[:3, 3].tolist(), se3.quaternion_from_rotation(pose[:3, :3]).tolist())


def seen(pose: Array) -> PoseSample:
    there = se3.inverse(CAMERA) @ pose
    return PoseSample(0, "camera", there[:3, 3], se3.quaternion_from_rotation(there[:3, :3]))


def holding() -> Loop:
    loop = Loop(make_robot("panda"), READY["panda"])
    loop.run(0.02)
    return loop


def test_a_target_in_an_external_frame_is_followed() -> None:
    """Refused with the list of frames before its pose arrives; followed within 10 um after that."""
    loop = holding()
    goal = loop.pose()
    goal[:3, 3] += (0.02, -0.03, 0.01)
    with pytest.raises(TargetRefused, match=r"unknown frame 'camera'; valid: .*panda_hand"):
        loop.controller.on_target_pose(seen(goal), loop.now)
    loop.controller.on_transform(transform(CAMERA), loop.now)
    for _ in range(50):
        loop.controller.on_target_pose(seen(goal)._replace(stamp_ns=loop.now.ros_ns), loop.now)
        loop.run(0.02)
    loop.run(1.0)
    assert np.abs(loop.pose() - goal).max() < 1e-5


def test_jogging_in_the_axes_of_an_external_frame() -> None:
    loop = holding()
    begin = loop.pose()
    loop.controller.on_transform(transform(CAMERA), loop.now)
    for _ in range(30):
        loop.controller.on_target_twist(TwistSample(0, "camera", np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])), loop.now)
        loop.run(0.02)
    way = loop.pose()[:3, 3] - begin[:3, 3]
    assert np.linalg.norm(way) > 0.01
    assert way / np.linalg.norm(way) == pytest.approx(CAMERA[:3, 2], abs=1e-3)


def test_transforms_are_part_of_the_snapshot() -> None:
    """A recording that starts in the middle of a run contains them, as JSON."""
    loop = holding()
    loop.controller.on_transform(transform(CAMERA), loop.now)
    state = from_json(to_json(loop.controller.capture()), ControllerSnapshot)
    other = Controller(loop.robot, loop.settings)
    other.restore(state)
    assert (other.capture().frames.transforms["camera"] == loop.controller.capture().frames.transforms["camera"]).all()
    other.on_target_pose(seen(loop.pose()), loop.now)
    assert other.status.mode in (Mode.HOLDING, Mode.TRACKING)


@pytest.mark.parametrize(
    "text", ["camera 0 0 0 0 0 0 0", "camera 0 0 0 nan 0 0 1", "camera 0 0", "camera 0 0 x 0 0 0 1", "camera"]
)
def test_a_transform_that_is_not_a_pose_is_refused(text: str) -> None:
    loop = holding()
    with pytest.raises(TargetRefused):
        loop.controller.on_transform(text, loop.now)
    with pytest.raises(TargetRefused, match="unknown frame 'camera'"):
        loop.controller.on_target_pose(seen(loop.pose()), loop.now)


def test_a_frame_of_the_model_cannot_be_moved_by_a_transform() -> None:
    """tf may publish the robot's own frames, later than the last joint state; the poses of the model are used."""
    loop = holding()
    loop.controller.on_transform(transform(CAMERA).replace("camera", "panda_link3"), loop.now)
    assert "panda_link3" not in loop.controller.capture().frames.transforms


def test_only_links_are_valid_frames() -> None:
    """Fixed joints, locked joints and the root of Pinocchio are frames of its model, but no frames of tf."""
    loop = holding()
    robot = loop.robot
    links = {frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY}
    assert set(robot.frames) == links
    fixed = {frame.name for frame in robot.model.frames if frame.type == pin.FrameType.FIXED_JOINT}
    assert {"universe", "panda_joint8"} <= fixed
    for name in (*fixed - links, *robot.joints):
        with pytest.raises(TargetRefused) as refused:
            loop.controller.on_target_pose(seen(loop.pose())._replace(frame_id=name), loop.now)
        listed = str(refused.value).split("valid: ")[1].split(", ")
        assert set(listed) == links


def test_the_frames_of_every_input_are_found() -> None:
    one, three, four = np.zeros(3), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])
    assert frames_of(PoseSample(0, "a", one, four[0])) == ("a",)
    assert frames_of(PathSample(("a", "b", "a"), (0, 0, 0), three, four)) == ("a", "b")
    assert frames_of(TrajectorySample(0, "a", (0,), three, four, NONE, NONE)) == ("a",)
    assert frames_of(TwistSample(0, "a", np.zeros(6))) == ("a",)
    balls = [ObstacleSample(0, frame, "x", "add", "sphere", (0.1,), one, four[0], 0) for frame in "abb"]
    assert frames_of(tuple(balls)) == ("a", "b")
    assert frames_of("camera") == ()


def test_tf_is_looked_up_and_only_changes_are_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    """With tf2_ros: one pose per change, none for unconnected frames. Without it: none."""
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    assert not list(Transforms(None).lookup("base", ["camera"], 0, 0))

    place = SimpleNamespace(x=1.0, y=2.0, z=3.0)
    turn = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)

    class Buffer:
        def lookup_transform(self, base: str, frame: str, time: object) -> SimpleNamespace:
            del time
            if (base, frame) != ("base", "camera"):
                raise LookupError(frame)
            stamp = SimpleNamespace(sec=0, nanosec=0)
            transform = SimpleNamespace(translation=place, rotation=turn)
            return SimpleNamespace(header=SimpleNamespace(stamp=stamp), transform=transform)

    tf2 = ModuleType("tf2_ros")
    tf2.Buffer = Buffer  # type: ignore[attr-defined]
    tf2.TransformListener = lambda buffer, node: (buffer, node)  # type: ignore[attr-defined]
    tf2.TransformException = LookupError  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tf2_ros", tf2)
    transforms = Transforms(None)
    assert list(transforms.lookup("base", ["camera", "moon"], 0, 0)) == ["camera 1.0 2.0 3.0 0.0 0.0 0.0 1.0"]
    assert not list(transforms.lookup("base", ["camera"], 0, 0))
    place.x = 0.1
    assert list(transforms.lookup("base", ["camera"], 0, 0)) == ["camera 0.1 2.0 3.0 0.0 0.0 0.0 1.0"]


def test_an_empty_frame_is_the_base_frame_and_valid_frames_are_no_joints() -> None:
    robot = make_robot("panda")
    frames = Frames(robot)
    assert np.array_equal(frames.pose(""), np.eye(4))
    with pytest.raises(InputError, match="unknown frame 'kitchen'; valid: ") as caught:
        frames.pose("kitchen")
    valid = str(caught.value).split("valid: ")[1].split(", ")
    assert robot.base_frame in valid
    assert not {"universe", *robot.joints} & set(valid)

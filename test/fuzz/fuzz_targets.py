"""What is fuzzed: functions that take the bytes of a message or file, with valid inputs to start from.

A target reads its input with the real readers and raises AssertionError when a result is not of the declared shape or
size. Every exception but the declared ones is a fault; so are messages of more than one line.
"""

from __future__ import annotations

import io
import os
import shutil
import struct
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ik_node.collision.scene import MAX_OBSTACLES, read_scene
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import (
    LONGEST_MESSAGE,
    IkNodeError,
    InputError,
    RecordingError,
    RobotError,
    SceneError,
    SettingsError,
)
from ik_node.errors import TrajectoryFileError as PoseFileError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import (
    MAX_POSES,
    JointSample,
    ObstacleSample,
    PathSample,
    PoseSample,
    TrajectorySample,
    TwistSample,
)
from ik_node.interfaces.step import ARRAY_FIELDS, Level, Mode, Status, bare_step
from ik_node.jit import cache_folder
from ik_node.messages import encode
from ik_node.messages.cdr import BIG_ENDIAN, STORE, header, make, serialize
from ik_node.messages.decode import MAX_JOINTS, decode_command, decode_string
from ik_node.messages.decode_obstacles import MARKERS_TYPE, MAX_MARKERS
from ik_node.messages.decode_targets import PATH_TYPE, POSE_TYPE, TRAJECTORY_TYPE
from ik_node.messages.parameters import Parameters, decode_parameters, encode_parameters
from ik_node.messages.restamp import restamped
from ik_node.messages.step_codec import Call as CallRecord
from ik_node.messages.step_codec import (
    CallKind,
    StepDecoder,
    StepEncoder,
    decode_call,
    decode_texts,
    encode_call,
)
from ik_node.recording.bag_reader import BagReader
from ik_node.recording.call_log import RecordedCall, RecordedCalls, decode_snapshot, read_setup
from ik_node.recording.input_table import INPUTS
from ik_node.recording.json_codec import to_json
from ik_node.recording.mcap.file import ChannelInfo, McapFile, PendingChunk
from ik_node.recording.mcap.metadata import METADATA_FILE
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.repair import repair
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.recording.run_reader import load_run
from ik_node.replay.call_source import RecordingSource, argument_of
from ik_node.replay.external_bag import ExternalBag
from ik_node.robot.description import read_description
from ik_node.robot.robot import Robot
from ik_node.robot.srdf import disabled_pairs, read_srdf
from ik_node.settings.groups import ArmSettings, Settings
from ik_node.settings.parameter_file import parse_assignment, read_sections, read_settings
from ik_node.settings.yaml_text import with_uniform_numbers
from ik_node.trajectory.pose_file import load
from ik_node.trajectory.pose_file_format import PoseFileFormat

ROS_NS = 1_700_000_000 * NS
MESSAGES_PER_TOPIC = 16
"""Most messages of a topic in a seed."""
JOINTS = ("joint_1", "joint_2")
URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><mass value="1"/><origin xyz="0 0 0.1" rpy="0 0 0"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.3"/><geometry><sphere radius="0.05"/></geometry></collision></link>
<link name="fore"/><link name="finger"/><link name="tool"/>
<joint name="joint_1" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1" rpy="0 0 1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="2" effort="9"/></joint>
<joint name="joint_2" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/></joint>
<joint name="finger_joint" type="prismatic"><parent link="fore"/><child link="finger"/><axis xyz="1 0 0"/>
<mimic joint="joint_1" multiplier="0.5" offset="0.1"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>
<joint name="flange" type="fixed"><parent link="fore"/><child link="tool"/></joint></robot>"""
SRDF = """<?xml version="1.0" encoding="utf-8"?><robot name="arm"><disable_collisions link1="base" link2="upper"/>
<disable_default_collisions link="fore"/><enable_collisions link1="fore" link2="tool"/></robot>"""
SCENE = b"""obstacles:
  - {name: post, cylinder: {radius: 0.05, length: 0.6}, position: [0.45, 0.1, 0.3], velocity: [0, 0.1, 0]}
  - {name: ball, sphere: {radius: 0.1}, orientation: [0, 0, 0, 1], frame: base}
  - {box: {size: [0.1, 0.2, 0.3]}}
  - capsule: {radius: 0.1, length: 1e-1}
"""
PARAMETERS = b"""/**:
  ik_node:
    ros__parameters:
      robot: panda
      gain: [5, 7.5]
      limits: {acceleration: [10.0], hold_periods: 5}
      obstacles.package_path: ["/opt/meshes"]
      follow: {enabled: false}
      use_sim_time: true
"""
METADATA = b"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration: {nanoseconds: 4000000}
  starting_time: {nanoseconds_since_epoch: 1700000000000000000}
  message_count: 3
  topics_with_message_count:
    - topic_metadata: {name: /joint_states, type: sensor_msgs/msg/JointState, serialization_format: cdr,
        offered_qos_profiles: ""}
      message_count: 3
  compression_format: ""
  compression_mode: ""
  relative_file_paths: [bag_0.mcap]
  files: [{path: bag_0.mcap, message_count: 3}]
  custom_data: {dropped: "0", ik_node: 0.2.0}
"""


class FuzzTarget(NamedTuple):
    """One function under test."""

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    """Valid inputs."""
    errors: tuple[type[IkNodeError], ...]
    """What may be raised."""
    runs: int
    """Inputs of the long run; together a million."""
    max_bytes: int = 2048
    words: tuple[bytes, ...] = ()
    """Parts of inputs that random bytes do not find."""


def check_input(target: FuzzTarget, data: bytes) -> bool:
    """Runs a target; fails for other exceptions than the declared ones. Returns whether the input was accepted."""
    try:
        target.run(data)
    except target.errors as error:
        text = str(error)
        assert text.isprintable(), f"not one line of text: {text[:300]!r}"
        assert 0 < len(text) <= LONGEST_MESSAGE, f"an error of {len(text)} characters: {text[:300]!r}"
        return False
    return True


# --- messages --------------------------------------------------------------------------------------------------------


def _check_floats(values: Any, *shape: int) -> None:
    assert isinstance(values, np.ndarray)
    assert values.dtype == np.float64
    assert values.shape == shape, f"{values.shape}, expected {shape}"


def check_sample(kind: CallKind, sample: Any) -> None:
    """Fails unless a decoded input has the declared types and shapes, within its bounds."""
    if kind is CallKind.ON_JOINT_STATE:
        assert isinstance(sample, JointSample)
        assert len(sample.names) <= MAX_JOINTS
        assert sample.position.size <= MAX_JOINTS
        _check_floats(sample.position, sample.position.size)
    elif kind is CallKind.ON_TARGET_POSE:
        assert isinstance(sample, PoseSample)
        _check_floats(sample.position, 3)
        _check_floats(sample.quaternion, 4)
    elif kind is CallKind.ON_TARGET_TWIST:
        assert isinstance(sample, TwistSample)
        _check_floats(sample.twist, 6)
    elif kind is CallKind.ON_TARGET_PATH:
        assert isinstance(sample, PathSample)
        count = len(sample.stamps_ns)
        assert count <= MAX_POSES
        assert len(sample.frame_ids) in (0, count)
        _check_floats(sample.positions, count, 3)
        _check_floats(sample.quaternions, count, 4)
    elif kind is CallKind.ON_TARGET_TRAJECTORY:
        assert isinstance(sample, TrajectorySample)
        count = len(sample.times_ns)
        assert count <= MAX_POSES
        _check_floats(sample.positions, count, 3)
        _check_floats(sample.quaternions, count, 4)
        for rows in (sample.twists, sample.accelerations):
            assert len(rows) in (0, count)
            _check_floats(rows, len(rows), 6)
    else:
        assert isinstance(sample, tuple)
        assert len(sample) <= MAX_MARKERS
        for entry in sample:
            assert isinstance(entry, ObstacleSample)
            assert len(entry.size) <= 3
            _check_floats(entry.position, 3)
            _check_floats(entry.quaternion, 4)


def _decode_input(kind: CallKind, data: bytes) -> None:
    check_sample(kind, INPUTS[kind].decode(data))


def _decode_command(data: bytes) -> None:
    numbers = decode_command(data)
    assert numbers.size <= MAX_JOINTS
    _check_floats(numbers, numbers.size)


def _decode_string(data: bytes) -> None:
    text = decode_string(data)
    assert isinstance(text, str)
    assert len(text) <= len(data)


def _decode_parameters(data: bytes) -> None:
    for values in decode_parameters(data):
        for name, value in values.items():
            assert isinstance(name, str)
            assert isinstance(value, (bool, int, float, str, tuple))


def split(data: bytes) -> list[bytes]:
    """The parts of an input with several messages; each follows its length."""
    parts, offset = [], 0
    while offset + 2 <= len(data):
        (length,) = struct.unpack_from("<H", data, offset)
        parts.append(data[offset + 2 : offset + 2 + length])
        offset += 2 + length
    return parts


def joined(parts: list[bytes]) -> bytes:
    """Inverse of :func:`split`."""
    return b"".join(struct.pack("<H", len(part)) + part for part in parts)


def _decode_steps(data: bytes) -> None:
    texts, *steps = split(data) or [b""]
    decoder = StepDecoder()
    decoder.texts(texts)
    for message in steps:
        step = decoder.step(message)
        n = len(step.joint_position)
        for field in ARRAY_FIELDS:
            _check_floats(getattr(step, field.name), *field.shape(n))
        assert isinstance(step.tick, int)
        assert isinstance(step.status, Status)


def _decode_text_record(data: bytes) -> None:
    assert isinstance(decode_texts(data).number, int)


def _decode_call(data: bytes) -> None:
    assert isinstance(decode_call(data).kind, CallKind)


RESTAMPED = (POSE_TYPE, PATH_TYPE, TRAJECTORY_TYPE, MARKERS_TYPE, "sensor_msgs/msg/JointState")


def _restamp(data: bytes) -> None:
    number, later = (data[0], data[1]) if len(data) > 1 else (0, 0)
    again = restamped(data[2:], RESTAMPED[number % len(RESTAMPED)], (later - 128) * NS)
    assert isinstance(again, bytes)


def _decode_snapshot(data: bytes) -> None:
    snapshot = decode_snapshot(data.decode(errors="replace"), ControllerSnapshot)
    assert isinstance(snapshot, ControllerSnapshot)


def _read_setup(data: bytes) -> None:
    setup = read_setup(data.decode(errors="replace"))
    assert isinstance(setup, dict)


def _poses(count: int) -> list[Any]:
    return [pose_message(0.1 * number) for number in range(count)]


def pose_message(x: float) -> Any:
    """A geometry_msgs/Pose."""
    point = make("geometry_msgs/msg/Point", x=x, y=0.2, z=0.3)
    return make("geometry_msgs/msg/Pose", position=point, orientation=quaternion_message())


def quaternion_message(x: float = 0.0, y: float = 0.0, z: float = 0.0, w: float = 1.0) -> Any:
    """A geometry_msgs/Quaternion."""
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def vector_message(x: float, y: float, z: float) -> Any:
    """A geometry_msgs/Vector3."""
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def path_message(frame: str, poses: list[Any], stamps_ns: list[int]) -> Any:
    """A nav_msgs/Path; ``poses``: geometry_msgs/Pose."""
    stamped = [
        make(POSE_TYPE, header=header(frame, stamp), pose=pose) for pose, stamp in zip(poses, stamps_ns, strict=True)
    ]
    return make(PATH_TYPE, header=header(frame), poses=stamped)


def trajectory_message(frame: str, poses: list[Any], period_ns: int, with_twists: bool) -> Any:
    """A trajectory_msgs/MultiDOFJointTrajectory; ``poses``: geometry_msgs/Pose."""
    zero = vector_message(0.0, 0.0, 0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    points = []
    for number, pose in enumerate(poses):
        place = pose.position
        transform = make(
            "geometry_msgs/msg/Transform",
            translation=vector_message(place.x, place.y, place.z),
            rotation=pose.orientation,
        )
        seconds, nanoseconds = divmod(number * period_ns, NS)
        points.append(
            make(
                "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
                transforms=[transform],
                velocities=[twist] if with_twists else [],
                accelerations=[twist] if with_twists else [],
                time_from_start=make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=nanoseconds),
            )
        )
    return make(TRAJECTORY_TYPE, header=header(frame), joint_names=["tool"], points=points)


def markers_message(frame: str, entries: list[tuple[str, int, int, int, Any, float, int]]) -> Any:
    """A visualization_msgs/MarkerArray; entries: namespace, number, type, action, pose, size, lifetime in ns."""
    markers = []
    for namespace, number, kind, action, pose, size, lifetime_ns in entries:
        seconds, nanoseconds = divmod(lifetime_ns, NS)
        image = make("sensor_msgs/msg/CompressedImage", header=header(""), format="", data=np.empty(0, np.uint8))
        markers.append(
            make(
                "visualization_msgs/msg/Marker",
                header=header(frame),
                ns=namespace,
                id=number,
                type=kind,
                action=action,
                pose=pose,
                scale=vector_message(size, size, 2.0 * size),
                color=make("std_msgs/msg/ColorRGBA", r=1.0, g=0.0, b=0.0, a=1.0),
                lifetime=make("builtin_interfaces/msg/Duration", sec=seconds, nanosec=nanoseconds),
                frame_locked=False,
                points=[make("geometry_msgs/msg/Point", x=0.0, y=0.0, z=0.0)] if kind > 3 else [],
                colors=[],
                texture_resource="",
                texture=image,
                uv_coordinates=[],
                text="text" if kind == 9 else "",
                mesh_resource="",
                mesh_file=make("visualization_msgs/msg/MeshFile", filename="", data=np.empty(0, np.uint8)),
                mesh_use_embedded_materials=False,
            )
        )
    return make(MARKERS_TYPE, markers=markers)


def _message_seeds(kind: CallKind) -> list[bytes]:
    if kind is CallKind.ON_JOINT_STATE:
        messages = [
            encode.encode_joint_state(names, ROS_NS, np.arange(len(names), dtype=np.float64), velocity)
            for names, velocity in ((JOINTS, None), (("a",), np.ones(1)), (tuple("abcdefgh"), None))
        ]
        big_endian = STORE.serialize_cdr(
            STORE.deserialize_cdr(messages[0], INPUTS[kind].type_name), INPUTS[kind].type_name, little_endian=False
        )
        assert bytes(big_endian[:2]) == BIG_ENDIAN
        return [*messages, bytes(big_endian)]
    if kind is CallKind.ON_TARGET_POSE:
        return [encode.encode_pose(frame, stamp, np.ones(3), np.eye(4)[3]) for frame, stamp in (("", 0), ("b", ROS_NS))]
    if kind is CallKind.ON_TARGET_TWIST:
        return [encode.encode_twist("tool", ROS_NS, np.ones(6))]
    if kind is CallKind.ON_TARGET_PATH:
        return [serialize(path_message("base", _poses(count), [0] * count)) for count in (0, 1, 3)]
    if kind is CallKind.ON_TARGET_TRAJECTORY:
        return [serialize(trajectory_message("base", _poses(3), NS, with_twists)) for with_twists in (False, True)]
    pose = pose_message(0.1)
    entries = [("shelf", number, kind_, action, pose, 0.1, 0) for number, kind_, action in ((1, 1, 0), (2, 9, 0))]
    return [serialize(markers_message("base", entries)), serialize(markers_message("", [("", 0, 0, 3, pose, 0.0, NS)]))]


def _parameter_seeds() -> list[bytes]:
    values: dict[str, Any] = {
        "flag": True, "count": 3, "gain": 0.5, "method": "plain", "list": (1.0, 2.0), "names": ("a", "b")
    }  # fmt: skip
    return [encode_parameters("/ik_node", ROS_NS, Parameters(values, {"gain": 0.5}))]


def _step_seeds() -> list[bytes]:
    status, encoder = Status(Level.OK, Mode.HOLDING, "at rest"), StepEncoder("/ik_node", 2)
    found: list[bytes] = []
    for tick in range(2):
        step = bare_step(tick, Instant(NS, ROS_NS), NS, np.zeros(2), np.eye(4), np.zeros(2), status)
        texts, message = encoder.encode(step)
        found += [message] if texts is None else [texts, message]
    return [joined(found)]


def _text_record_seeds() -> list[bytes]:
    return [split(_step_seeds()[0])[0]]


def _call_seeds() -> list[bytes]:
    return [encode_call(CallRecord(kind, 3, Instant(NS, ROS_NS))) for kind in CallKind]


def _restamp_seeds() -> list[bytes]:
    kinds = (CallKind.ON_TARGET_POSE, CallKind.ON_TARGET_PATH, CallKind.ON_TARGET_TRAJECTORY, CallKind.ON_OBSTACLES)
    seeds = [bytes((number, 129)) + _message_seeds(kind)[-1] for number, kind in enumerate(kinds)]
    return [*seeds, b"\x04\x7f" + _message_seeds(CallKind.ON_JOINT_STATE)[0]]


# --- files -----------------------------------------------------------------------------------------------------------


@cache
def sandbox() -> Path:
    """Folder of this process for the files that are read."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="ik_node_fuzz_", dir=memory if os.access(memory, os.W_OK) else None))
    (folder / "bag").mkdir()
    (folder / "outside.mcap").write_bytes(b"\x89MCAP0\r\n")
    return folder


def remove_sandbox() -> None:
    """Removes the folder of this process; tests of this module that come later have another one."""
    shutil.rmtree(sandbox(), ignore_errors=True)
    sandbox.cache_clear()


_guarded: list[str] = []
_opened_outside: list[str] = []
_LIBRARIES = tuple(
    {str(Path(path).resolve()) for path in (sys.prefix, sys.base_prefix, cache_folder(), *sys.path) if path}
)
_TEMPORARY = os.path.realpath(tempfile.gettempdir())
"""Opened as a folder for unnamed files."""


def _on_audit(event: str, arguments: tuple[Any, ...]) -> None:
    if event == "open" and _guarded and isinstance(arguments[0], (str, bytes)):
        path = os.path.realpath(os.fsdecode(arguments[0]))
        if not path.startswith((_guarded[-1], *_LIBRARIES)) and path != _TEMPORARY:
            _opened_outside.append(path)


sys.addaudithook(_on_audit)


@contextmanager
def only_inside(folder: Path) -> Iterator[None]:
    """Fails when Python opens a file outside of ``folder`` (and of the libraries)."""
    _guarded.append(str(folder.resolve()))
    try:
        yield
    finally:
        _guarded.pop()
        outside = _opened_outside.copy()
        _opened_outside.clear()
        if outside:
            raise AssertionError(f"opened outside of {folder}: {outside}")


def _written(name: str, data: bytes) -> Path:
    path = sandbox() / name
    path.write_bytes(data)
    return path


def _parameter_file(data: bytes) -> None:
    path = _written("parameters.yaml", data)
    text = data.decode(errors="replace")
    with_uniform_numbers(text)
    if "=" in text[:40]:
        name, _ = parse_assignment(text)
        assert name in Settings().flat()
        return
    for section, values in read_sections(path).items():
        assert isinstance(section, str)
        assert all(isinstance(name, str) for name in values)
    assert isinstance(read_settings(path), Settings)


def _scene(data: bytes) -> None:
    with only_inside(sandbox()):
        scene = read_scene(_written("scene.yaml", data), lambda _: np.eye(4))
    assert len(scene.obstacles) <= MAX_OBSTACLES
    for entry in scene.obstacles.values():
        _check_floats(entry.pose_s, 4, 4)
        assert np.isfinite(entry.pose_s).all()
        assert np.isfinite(entry.velocity_s).all()
        assert all(0.0 < side < 1e3 for side in entry.shape.size)


def _pose_file(suffix: str, data: bytes) -> None:
    with only_inside(sandbox()):
        trajectory = load(
            _written(f"poses{suffix}", data), PoseFileFormat(order="xyzw" if suffix == ".npy" else ""), np.eye(4)
        )
    assert trajectory.describe().isprintable()
    for time_s in (0.0, 0.5 * trajectory.duration_s, trajectory.duration_s):
        assert np.isfinite(trajectory.pose(time_s)).all()


def _description(data: bytes) -> None:
    description = read_description(data.decode(errors="replace"))
    assert len(description.masses) == len(description.joints) + 1


def _robot(data: bytes) -> None:
    """Pinocchio reads what passed the checks; a crash ends this process."""
    robot = Robot(data.decode(errors="replace"))
    q = np.zeros(robot.n)
    pose, jacobian = robot.evaluate(q)
    assert np.isfinite(pose).all()
    assert np.isfinite(jacobian).all()
    assert jacobian.shape == (6, robot.n)


def _srdf(data: bytes) -> None:
    text = data.decode(errors="replace")
    if text.lstrip().startswith("<"):
        for pair in disabled_pairs(read_srdf(text, ArmSettings()), ("base", "upper", "fore", "tool")):
            assert all(isinstance(link, str) for link in pair)


def _bag(data: bytes, name: str = METADATA_FILE) -> Path:
    """The bag with a file that is replaced by ``data``; only the metadata and the first part are files of it."""
    folder = sandbox() / "bag"
    for file in folder.iterdir():
        file.unlink()
    (folder / "bag_0.mcap").write_bytes(small_bag())
    (folder / name).write_bytes(data)
    return folder


def _metadata(data: bytes) -> None:
    folder = _bag(data)
    with only_inside(folder):
        failed: list[IkNodeError] = []
        for read in (_read_messages, _read_bag):
            try:
                read(folder)
            except RecordingError as error:
                failed.append(error)
    if failed:
        raise max(failed, key=lambda error: len(str(error)))


def _read_messages(path: Path) -> None:
    recording = Recording(path)
    recording.counts()
    for message in recording.messages():
        assert isinstance(message.data, bytes)


def _read_bag(path: Path) -> None:
    reader = BagReader(path)
    for _, time_ns, data in reader.messages([topic.name for topic in reader.counts]):
        assert 0 <= time_ns < 2**63
        assert isinstance(data, bytes)


def _mcap(read: Callable[[Path], None], data: bytes) -> None:
    folder = _bag(data, "bag_0.mcap")
    with only_inside(folder):
        read(folder / "bag_0.mcap")


def _repair(path: Path) -> None:
    try:
        done = repair(path)
    finally:
        assert sorted(file.name for file in path.parent.iterdir()) == ["bag_0.mcap"]
    if not done.was_complete:
        assert all(part.messages >= 0 for part in done.parts)
        again = Recording(path)
        assert again.complete
        assert sum(again.counts().values()) == sum(1 for _ in again.messages()) == done.parts[0].messages


def _read_run(path: Path) -> None:
    run = load_run(path)
    assert len(run.times_s) == len(run.tick) > 0


def _read_calls(path: Path) -> None:
    source: RecordedCalls = RecordingSource(path)
    for entry in source.entries():
        if isinstance(entry, RecordedCall) and entry.step is not None:
            source.steps.step(entry.step)
        if isinstance(entry, RecordedCall):
            argument_of(source, entry, {})  # type: ignore[arg-type]


def _read_external(path: Path) -> None:
    bag = ExternalBag(path, Settings().with_values({"robot_description": URDF}))
    bag.targets()
    for number, entry in enumerate(bag.entries()):
        assert number < 1_000_000
        assert entry.call.now.monotonic_ns >= 0


def _of_messages(read: Callable[[Path], None], data: bytes) -> None:
    """A valid file of messages with any content: topic number and message in turn."""
    folder = sandbox() / "bag"
    for old in folder.iterdir():
        old.unlink()
    path = folder / "bag_0.mcap"
    topics = run_topics()
    pending, sequences = PendingChunk(), [0] * len(topics)
    for number, part in enumerate(split(data)):
        topic = part[0] % len(topics) if part else 0
        pending.add(topic + 1, sequences[topic], ROS_NS + number, ROS_NS + number, part[1:])
        sequences[topic] += 1
    file = McapFile.create(path, "fuzz", "none")
    for name, type_name in topics:
        file.add_channel(ChannelInfo(name, type_name, "", {}))
    file.add_chunk(pending)
    file.finish()
    with only_inside(folder):
        read(path)


@cache
def small_run() -> bytes:
    """A recording of a few control steps, with a call of every kind, as one MCAP file without checksums."""
    from call_sequences import recorded_example

    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory) / "run"
        recorded_example(folder, RecorderOptions(compression="none", own_thread=False))
        (file,) = folder.glob("*.mcap")
        return file.read_bytes()


@cache
def small_bag() -> bytes:
    """A bag of joint states and targets."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "bag_0.mcap"
        file = McapFile.create(path, "fuzz", "none")
        pending = PendingChunk()
        kinds = (CallKind.ON_JOINT_STATE, CallKind.ON_TARGET_POSE)
        for channel, kind in enumerate(kinds, 1):
            file.add_channel(ChannelInfo(f"/{INPUTS[kind].name}", INPUTS[kind].type_name, "", {}))
            for number in range(3):
                time_ns = ROS_NS + 2_000_000 * number
                pending.add(channel, number, time_ns, time_ns, _message_seeds(kind)[0])
        file.add_chunk(pending)
        file.finish()
        return path.read_bytes()


@cache
def run_topics() -> tuple[tuple[str, str], ...]:
    """Topics of :func:`small_run` with their types."""
    path = _written("run.mcap", small_run())
    return tuple(dict.fromkeys((message.topic, message.type_name) for message in Recording(path).messages()))


def _run_seeds() -> list[bytes]:
    path = _written("run.mcap", small_run())
    names = [name for name, _ in run_topics()]
    used: Counter[str] = Counter()
    parts = []
    for message in Recording(path).messages():
        used[message.topic] += 1
        if used[message.topic] <= MESSAGES_PER_TOPIC:
            parts.append(bytes((names.index(message.topic),)) + message.data)
    return [joined(parts)]


def _bag_message_seeds() -> list[bytes]:
    return [small_bag()]


def _cut_seeds() -> list[bytes]:
    whole = small_run()
    return [whole[: len(whole) // 2], whole[:-50], small_bag()[:-200], small_bag()]


def _npy_seeds() -> list[bytes]:
    found = []
    rows = np.array([[0.0, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0], [1.0, 0.1, 0.2, 0.4, 0.0, 0.6, 0.0, 0.8]])
    for array in (rows, rows[:, 1:], rows.astype(np.float32), np.asfortranarray(rows)):
        stream = io.BytesIO()
        np.save(stream, array)
        found.append(stream.getvalue())
    return found


def _pose_text_seeds() -> list[bytes]:
    return [
        b"time_ms,goal_pos_x,goal_pos_y,goal_pos_z,goal_qx,goal_qy,goal_qz,goal_qw\n0,0.1,0.2,0.3,0,0,0,1\n1e1,0.2,0.2,0.3,0,0,1,0\n",
        b"# x y z\n0.1 0.2 0.3\n0.2 0.3 0.4\n0.3 0.3 0.3\n",
        b"x;y;z;qx;qy;qz;qw\n0;0;0;0;0;0;1\n1;0;0;0;0;1;0\n",
        b"1 0 0 0.1 0 1 0 0.2 0 0 1 0.3\n1 0 0 0.2 0 1 0 0.2 0 0 1 0.3\n",
        b'{"x": 1, "y": 2, "z": 3, "t": 0}\n{"x": 2, "y": 2, "z": 3, "t": 1}\n',
        b"x\ty\n1\t2\n2\t3\n",
    ]


def _parameter_file_seeds() -> list[bytes]:
    return [PARAMETERS, b"gain=[1, 2.5]", b"method=plain", b"limits.velocity=[1e0]", b"ik_node: {ros__parameters: {}}"]


def _snapshot_seeds() -> list[bytes]:
    from call_sequences import example_snapshot

    return [to_json(example_snapshot()).encode()]


def _setup_seeds() -> list[bytes]:
    path = _written("run.mcap", small_run())
    found = [message.data for message in Recording(path).messages() if message.topic.endswith("/setup")]
    return [decode_string(found[0]).encode()]


YAML_WORDS = (b"!!int ", b"!!float ", b"!!python/object:", b"!!timestamp ", b"!!binary ", b"!!set ", b"!!omap ",
              b"<<: ", b"&a ", b"*a", b"? ", b"- ", b": ", b"| ", b"> ", b".inf", b".nan", b"0x", b"1e999", b"null",
              b"\\u0000", b"\\ud800", b"2001-01-01")  # fmt: skip
PATH_WORDS = (b"../outside.mcap", b"/dev/zero", b"..", b"/etc/passwd", b"bag_0.mcap/../../outside.mcap", b"\\0")
XML_WORDS = (b"<!DOCTYPE r [", b"<!ENTITY a 'b'>", b"]>", b"<![CDATA[", b"]]>", b"&#0;", b"&lt;",
             b"<?xml version='1.0'?>", b"<link name='", b"<joint name='", b"<mimic joint='", b"<limit ",
             b"type='floating'", b"type='planar'", b"nan", b"inf", b"1e308", b"xmlns:a='b'", b"<mesh filename='",
             b"<cylinder ", b"<gazebo>")  # fmt: skip
NUMBER_WORDS = (
    b"nan",
    b"inf",
    b"-1e308",
    b"1e999",
    b"1_0",
    "٣".encode(),
    b"\xef\xbb\xbf",
    b"\r",
    b"\x0b",
    b"\x00",
    b'"',
)
MCAP_WORDS = (b"\x89MCAP0\r\n", b"zstd", b"lz4", b"\xff" * 8, b"\0" * 8, (1 << 62).to_bytes(8, "little"),
              (1 << 31).to_bytes(8, "little"), b"cdr", b"ros2msg", b"json")  # fmt: skip
_NUMBERS = (b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", struct.pack("<d", np.nan), struct.pack("<d", np.inf),
            struct.pack("<d", 1e300))  # fmt: skip
_INPUT_ERRORS = (InputError,)
_RECORDING_ERRORS = (InputError, RecordingError)
_READ_ERRORS = (IkNodeError,)

TARGETS: dict[str, FuzzTarget] = {
    **{
        f"decode_{entry.name}": FuzzTarget(
            partial(_decode_input, kind), partial(_message_seeds, kind), _INPUT_ERRORS, 90_000, 2048, _NUMBERS
        )
        for kind, entry in INPUTS.items()
    },
    "decode_command": FuzzTarget(
        _decode_command, lambda: [encode.encode_command(np.ones(7))], _INPUT_ERRORS, 80_000, 1024, _NUMBERS
    ),
    "decode_string": FuzzTarget(_decode_string, lambda: [encode.encode_string("text")], _INPUT_ERRORS, 40_000),
    "decode_parameters": FuzzTarget(_decode_parameters, _parameter_seeds, _RECORDING_ERRORS, 80_000, 2048, _NUMBERS),
    "decode_steps": FuzzTarget(_decode_steps, _step_seeds, _RECORDING_ERRORS, 60_000, 8192, _NUMBERS),
    "decode_texts": FuzzTarget(_decode_text_record, _text_record_seeds, _RECORDING_ERRORS, 80_000, 1024, _NUMBERS),
    "decode_call": FuzzTarget(_decode_call, _call_seeds, _RECORDING_ERRORS, 60_000, 256, _NUMBERS),
    "restamp": FuzzTarget(_restamp, _restamp_seeds, _INPUT_ERRORS, 60_000, 2048, _NUMBERS),
    "snapshot": FuzzTarget(_decode_snapshot, _snapshot_seeds, _RECORDING_ERRORS, 2_000, 16_384),
    "setup": FuzzTarget(_read_setup, _setup_seeds, _RECORDING_ERRORS, 20_000, 4096),
    "parameter_file": FuzzTarget(
        _parameter_file, _parameter_file_seeds, (SettingsError, InputError), 3_000, 1024, YAML_WORDS
    ),
    "scene": FuzzTarget(_scene, lambda: [SCENE], (SceneError,), 3_000, 1024, YAML_WORDS),
    "pose_text": FuzzTarget(partial(_pose_file, ".csv"), _pose_text_seeds, (PoseFileError,), 5_000, 1024, NUMBER_WORDS),
    "pose_npy": FuzzTarget(partial(_pose_file, ".npy"), _npy_seeds, (PoseFileError,), 5_000, 1024),
    "description": FuzzTarget(_description, lambda: [URDF.encode()], (RobotError,), 10_000, 4096, XML_WORDS),
    "robot": FuzzTarget(_robot, lambda: [URDF.encode()], (RobotError,), 3_000, 4096, XML_WORDS),
    "srdf": FuzzTarget(_srdf, lambda: [SRDF.encode()], (SettingsError,), 5_000, 1024, XML_WORDS),
    "metadata": FuzzTarget(_metadata, lambda: [METADATA], _READ_ERRORS, 1_000, 2048, YAML_WORDS + PATH_WORDS),
    "mcap": FuzzTarget(partial(_mcap, _read_messages), _bag_message_seeds, _READ_ERRORS, 3_000, 8192, MCAP_WORDS),
    "repair": FuzzTarget(partial(_mcap, _repair), _cut_seeds, _READ_ERRORS, 1_500, 65_536, MCAP_WORDS),
    "bag": FuzzTarget(partial(_mcap, _read_bag), _bag_message_seeds, _READ_ERRORS, 2_000, 8192, MCAP_WORDS),
    "run_messages": FuzzTarget(partial(_of_messages, _read_run), _run_seeds, _READ_ERRORS, 2_000, 65_536, _NUMBERS),
    "call_messages": FuzzTarget(partial(_of_messages, _read_calls), _run_seeds, _READ_ERRORS, 1_000, 65_536, _NUMBERS),
    "external_bag": FuzzTarget(partial(_of_messages, _read_external), _run_seeds, _READ_ERRORS, 500, 65_536, _NUMBERS),
}
"""Name -> what is fuzzed."""

"""Encoding and decoding agree with ROS: rclpy's deserialiser reads what the package encodes, and the package decodes
bit for bit what rclpy's serialiser writes. Steps and calls survive encoding as standard messages exactly, because
replays are compared bit for bit. Not tested here: transport over DDS (tests of the node)."""

from __future__ import annotations

import importlib
import itertools
import struct
from typing import Any

import numpy as np
import pytest
from made_steps import STOPPED, made_step, quaternion_of, same_bits, steps, stopped_step
from rosbags.typesys import Stores, get_typestore

from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, TEXT_FIELDS, Level, Mode, Status, Step
from ik_node.messages import decode, decode_targets, encode, step_codec, step_outputs
from ik_node.messages.cdr import deserialize, serialize
from ik_node.messages.parameters import Parameters, decode_parameters, encode_parameters
from ik_node.messages.step_codec import STEP_TYPE, Call, CallKind, StepDecoder, StepEncoder, text_fields
from ik_node.messages.step_outputs import StepOutputs
from ik_node.settings.groups import Settings
from ik_node.settings.schema import Value

JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
STAMP_NS = 1_700_000_000_123_456_789
POSE = "geometry_msgs/msg/PoseStamped"
STATE = "sensor_msgs/msg/JointState"
STORE = get_typestore(Stores.ROS2_JAZZY)


def ros_class(type_name: str) -> Any:
    """Return rclpy's message class."""
    pytest.importorskip("rclpy", reason="ROS 2 is not installed: no independent serialiser to compare with")
    package, _, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def by_ros(data: bytes, type_name: str) -> Any:
    """Deserialise the bytes with rclpy."""
    kind = ros_class(type_name)
    from rclpy.serialization import deserialize_message

    return deserialize_message(data, kind)


def from_ros(message: Any) -> bytes:
    """Serialise the message with rclpy."""
    from rclpy.serialization import serialize_message

    return bytes(serialize_message(message))


def stamp_of(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def numbers(*groups: Any) -> list[float]:
    """x, y, z (and w) of points, vectors and quaternions."""
    return [getattr(group, axis) for group in groups for axis in "xyzw" if hasattr(group, axis)]


# --- encoding, read by ROS ---


@pytest.mark.parametrize("frame_id", ["", "a", "panda_link0", "ünïcode", "four", "world/left arm"])
@pytest.mark.parametrize("stamp_ns", [0, 1, STAMP_NS, 2**31 * 10**9 - 1, -1_500_000_000])
def test_poses_twists_and_wrenches_mean_the_same_to_ros(frame_id: str, stamp_ns: int) -> None:
    """Frame names of every alignment, smallest and largest stamps; special numbers pass unchanged."""
    values = np.array([1.5, -0.0, np.inf, 5e-324, np.nan, -1e300, 1 / 3])
    pose = by_ros(encode.encode_pose(frame_id, stamp_ns, values[:3], values[3:]), "geometry_msgs/msg/PoseStamped")
    assert (pose.header.frame_id, stamp_of(pose)) == (frame_id, stamp_ns)
    assert same_bits(np.array(numbers(pose.pose.position, pose.pose.orientation)), values)
    twist = by_ros(encode.encode_twist(frame_id, stamp_ns, values[:6]), "geometry_msgs/msg/TwistStamped")
    assert (twist.header.frame_id, stamp_of(twist)) == (frame_id, stamp_ns)
    assert same_bits(np.array(numbers(twist.twist.linear, twist.twist.angular)), values[:6])
    wrench = by_ros(encode.encode_wrench(frame_id, stamp_ns, values[:6]), "geometry_msgs/msg/WrenchStamped")
    assert (wrench.header.frame_id, stamp_of(wrench)) == (frame_id, stamp_ns)
    assert same_bits(np.array(numbers(wrench.wrench.force, wrench.wrench.torque)), values[:6])


@pytest.mark.parametrize("names", [(), ("a",), ("ab", "c"), JOINTS, tuple("abcdefgh")])
def test_joint_states_mean_the_same_to_ros(names: tuple[str, ...]) -> None:
    rng = np.random.default_rng(len(names))
    position, velocity = rng.normal(size=len(names)), rng.normal(size=len(names))
    for some_position in (position, None):
        for some_velocity in (velocity, None):
            data = encode.encode_joint_state(names, STAMP_NS, some_position, some_velocity)
            read = by_ros(data, "sensor_msgs/msg/JointState")
            assert (tuple(read.name), stamp_of(read)) == (names, STAMP_NS)
            assert list(read.position) == ([] if some_position is None else position.tolist())
            assert list(read.velocity) == ([] if some_velocity is None else velocity.tolist())
            assert list(read.effort) == []


@pytest.mark.parametrize("n", [1, 2, 6, 7, 30])
def test_commands_are_what_forwarding_controllers_take(n: int) -> None:
    command = np.random.default_rng(n).normal(size=n)
    data = encode.encode_command(command)
    read = by_ros(data, "std_msgs/msg/Float64MultiArray")
    assert list(read.data) == command.tolist()
    assert list(read.layout.dim) == []
    assert same_bits(decode.decode_command(data), command)


def test_commands_with_a_layout_are_understood() -> None:
    """Some publishers describe the single dimension of the array."""
    message = ros_class("std_msgs/msg/Float64MultiArray")()
    dimension = ros_class("std_msgs/msg/MultiArrayDimension")()
    dimension.label, dimension.size, dimension.stride = "joints", 2, 2
    message.layout.dim, message.data = [dimension], [1.5, -2.5]
    assert decode.decode_command(from_ros(message)).tolist() == [1.5, -2.5]
    message.layout.dim = []
    assert decode.decode_command(from_ros(message)).tolist() == [1.5, -2.5]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_no_command_leaves_that_is_not_finite(value: float) -> None:
    """This is the last check before the command is published."""
    with pytest.raises(InputError, match="not finite"):
        encode.encode_command(np.array([0.0, value]))


def test_arrays_of_another_shape_or_type_are_refused() -> None:
    """A template filled with a different number of bytes would produce an invalid message."""
    twists: tuple[Any, ...] = (np.zeros(5), np.zeros((6, 1)), np.zeros(6, dtype=np.float32))
    for twist in twists:
        with pytest.raises(InputError, match="expected float64"):
            encode.encode_twist("a", 0, twist)


def test_templates_give_the_bytes_of_the_plain_serialiser() -> None:
    """The templates and the typestore must give the same bytes, because recordings contain both."""
    rng = np.random.default_rng(1)
    for data, type_name in (
        (
            encode.encode_pose("base", STAMP_NS, rng.normal(size=3), rng.normal(size=4)),
            "geometry_msgs/msg/PoseStamped",
        ),
        (encode.encode_joint_state(JOINTS, STAMP_NS, rng.normal(size=7), None), "sensor_msgs/msg/JointState"),
        (encode.encode_command(rng.normal(size=7)), "std_msgs/msg/Float64MultiArray"),
        (encode.encode_wrench("tool0", STAMP_NS, rng.normal(size=6)), "geometry_msgs/msg/WrenchStamped"),
    ):
        assert serialize(deserialize(data, type_name)) == data


def test_status_and_diagnostics_mean_the_same_to_ros() -> None:
    for level in Level:
        status = Status(level, Mode.STOPPED, "no joint state for 0.1 s: überprüfen")
        read = by_ros(encode.encode_status(status, "/ik_node", {"scale": "1"}), "diagnostic_msgs/msg/DiagnosticStatus")
        assert (read.level, read.name, read.message) == (bytes([level.value]), "/ik_node", status.reason)
        assert {pair.key: pair.value for pair in read.values} == {"mode": "stopped", "scale": "1"}
    data = encode.encode_diagnostics([(STOPPED, "/a", {}), (STOPPED, "/b", {"x": "1"})], STAMP_NS)
    array = by_ros(data, "diagnostic_msgs/msg/DiagnosticArray")
    assert stamp_of(array) == STAMP_NS
    assert [status.name for status in array.status] == ["/a", "/b"]


def test_strings_mean_the_same_to_ros() -> None:
    for text in ("", "x", "überprüfen", "<robot/>" * 10_000):
        data = encode.encode_string(text)
        assert by_ros(data, "std_msgs/msg/String").data == text
        assert decode.decode_string(data) == text


# --- a Step on the output topics ---


def test_a_step_goes_out_on_every_topic_with_its_frames() -> None:
    step = made_step(4, 7)
    sent = {topic: by_ros(data, encode.TYPES[topic]) for topic, data in StepOutputs(JOINTS, "base", "tip").others(step)}
    assert set(sent) == set(encode.TYPES) - {encode.COMMANDS, encode.STATUS, encode.DIAGNOSTICS}
    assert {stamp_of(message) for message in sent.values()} == {step.now.ros_ns}
    velocity = sent[encode.JOINT_VELOCITY]
    assert (tuple(velocity.name), list(velocity.velocity)) == (JOINTS, step.joint_velocity.tolist())
    for topic, pose in ((encode.CURRENT_POSE, step.pose_sb), (encode.DESIRED_POSE, step.pose_sd)):
        read = sent[topic]
        assert read.header.frame_id == "base"
        wanted = [*pose[:3, 3].tolist(), *quaternion_of(pose).tolist()]
        assert numbers(read.pose.position, read.pose.orientation) == wanted
    error = sent[encode.TWIST_ERROR]
    assert error.header.frame_id == "tip"
    assert numbers(error.twist.linear, error.twist.angular) == step.error_b.tolist()
    for topic, term in (
        (encode.MULTIPLIER_TASK, step.multiplier_task),
        (encode.MULTIPLIER_POTENTIAL, step.multiplier_potential),
    ):
        assert sent[topic].header.frame_id == "tip"
        assert numbers(sent[topic].wrench.force, sent[topic].wrench.torque) == term.tolist()


def test_a_stopped_step_sends_zeros_and_nothing_that_was_not_computed() -> None:
    """NaN must not be published as a command or target."""
    step, outputs = stopped_step(0, 7), StepOutputs(JOINTS, "base", "tip")
    assert decode.decode_command(outputs.command(step)).tolist() == [0.0] * 7
    assert [topic for topic, _ in outputs.others(step)] == [encode.JOINT_VELOCITY]
    half = made_step(0, 7)
    half.pose_sd[0, 3] = np.nan
    assert encode.DESIRED_POSE not in [topic for topic, _ in outputs.others(half)]


@pytest.mark.parametrize("topic", step_outputs.STEP_TOPICS)
def test_only_the_messages_of_the_given_topics_are_made(topic: str) -> None:
    step, outputs = made_step(4, 7), StepOutputs(JOINTS, "base", "tip")
    assert outputs.others(step, [topic]) == [message for message in outputs.others(step) if message.topic == topic]


def test_status_values_say_the_figures_of_a_step() -> None:
    step = made_step(3, 7)
    values = step_outputs.step_values(step, "plain")
    assert values["method"] == "plain"
    assert float(values["scale"]) == pytest.approx(step.scale, rel=1e-5)
    assert float(values["sigma_min_m"]) == pytest.approx(step.singular_values.min(), rel=1e-5)
    assert float(values["position_error_mm"]) == pytest.approx(1e3 * np.linalg.norm(step.error_b[:3]), rel=1e-5)
    assert values["binding"] == "velocity panda_joint4, position panda_joint2"
    assert step_outputs.step_values(stopped_step(0, 7), "plain")["scale"] == "nan"


# --- decoding of messages written by ROS ---


@pytest.mark.parametrize("frame_id", ["", "base", "ünïcode"])
@pytest.mark.parametrize("names", [(), ("a",), JOINTS, ("gripper", "längs")])
def test_joint_states_of_ros_are_understood(frame_id: str, names: tuple[str, ...]) -> None:
    """With and without velocity and effort, and with the padding bytes that rclpy's serialiser sometimes appends."""
    message = ros_class("sensor_msgs/msg/JointState")()
    message.header.frame_id, message.name = frame_id, list(names)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP_NS, 1_000_000_000)
    values = np.random.default_rng(len(names)).normal(size=len(names))
    for fill in (("position",), ("position", "velocity"), ("position", "velocity", "effort"), ("velocity",)):
        for name in ("position", "velocity", "effort"):
            setattr(message, name, values.tolist() if name in fill else [])
        for _ in range(2):  # the second pass uses the cached names
            sample = decode.decode_joint_state(from_ros(message))
            assert (sample.stamp_ns, sample.names) == (STAMP_NS, names)
            assert same_bits(sample.position, values if "position" in fill else np.empty(0))


def test_names_of_another_driver_of_the_same_length_are_not_mistaken() -> None:
    """Names are cached between messages; those of a second driver must not be read as those of the first."""
    for names in (("a1", "a2"), ("b1", "b2"), ("a1", "a2"), ("a1", "b2")):
        assert decode.decode_joint_state(encode.encode_joint_state(names, 0, np.ones(2))).names == names


def test_poses_of_ros_are_understood() -> None:
    message = ros_class("geometry_msgs/msg/PoseStamped")()
    for frame_id in ("", "base", "ünïcode"):
        message.header.frame_id = frame_id
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(STAMP_NS, 1_000_000_000)
        position, orientation = message.pose.position, message.pose.orientation
        position.x, position.y, position.z = 1.0, np.nan, -0.0
        orientation.x, orientation.y, orientation.z, orientation.w = 0.1, 0.2, np.inf, 5.0
        sample = decode_targets.decode_pose(from_ros(message))
        assert (sample.stamp_ns, sample.frame_id) == (STAMP_NS, frame_id)
        assert same_bits(sample.position, np.array([1.0, np.nan, -0.0]))
        assert same_bits(sample.quaternion, np.array([0.1, 0.2, np.inf, 5.0]))


def test_messages_of_big_endian_machines_are_understood() -> None:
    pose = deserialize(encode.encode_pose("base", STAMP_NS, np.arange(3.0), np.arange(4.0)), POSE)
    sample = decode_targets.decode_pose(bytes(STORE.serialize_cdr(pose, POSE, little_endian=False)))
    assert (sample.stamp_ns, sample.frame_id, sample.quaternion.tolist()) == (STAMP_NS, "base", [0.0, 1.0, 2.0, 3.0])
    state = deserialize(encode.encode_joint_state(JOINTS, STAMP_NS, np.arange(7.0)), STATE)
    states = decode.decode_joint_state(bytes(STORE.serialize_cdr(state, STATE, little_endian=False)))
    assert (states.stamp_ns, states.names, states.position.tolist()) == (STAMP_NS, JOINTS, list(range(7)))


def test_damaged_bytes_are_refused_with_the_type_named() -> None:
    """Truncated messages and flipped bits either raise InputError or decode to some value; no other error occurs."""
    rng = np.random.default_rng(0)
    cases = (
        (decode.decode_joint_state, encode.encode_joint_state(JOINTS, STAMP_NS, np.ones(7)), "JointState"),
        (decode_targets.decode_pose, encode.encode_pose("base", STAMP_NS, np.ones(3), np.ones(4)), "PoseStamped"),
        (decode.decode_string, encode.encode_string("abc"), "String"),
        (decode.decode_command, encode.encode_command(np.ones(3)), "Float64MultiArray"),
    )
    for decoder, data, name in cases:
        for length in range(len(data) - 12):
            with pytest.raises(InputError, match=name):
                decoder(data[:length])
        for _ in range(300):
            damaged = bytearray(data)
            damaged[rng.integers(len(data))] = rng.integers(256)
            try:
                decoder(bytes(damaged))
            except InputError:
                continue


def test_what_is_decoded_can_be_changed_and_is_aligned() -> None:
    """Views into message bytes are read-only and unaligned; Pinocchio requires aligned arrays."""
    sample = decode.decode_joint_state(encode.encode_joint_state(JOINTS, 0, np.ones(7)))
    assert sample.position.flags.writeable
    assert sample.position.flags.aligned


# --- Step and calls ---


@pytest.mark.parametrize("n", [1, 6, 7, 8])
def test_steps_come_back_bit_for_bit(n: int) -> None:
    """Stopped steps with NaN, -0.0 and denormals, and changing texts equal the original after encoding and decoding."""
    run = steps(20, n)
    encoder, decoder = StepEncoder("/ik_node", n), StepDecoder()
    texts_written = 0
    for step in run:
        texts, data = encoder.encode(step)
        if texts is not None:
            texts_written += 1
            decoder.texts(texts)
        read = decoder.step(data)
        for name in Step._fields:
            assert same_bits(getattr(read, name), getattr(step, name)), name
    changes = sum(text_fields(one) != text_fields(two) for one, two in itertools.pairwise(run))
    assert texts_written == 1 + changes


def test_every_field_of_a_step_has_a_place_in_its_message() -> None:
    """Counters and times are encoded individually, all other fields by their type."""
    in_head = {"tick", "now", "state_time_ns"}
    declared = {field.name for field in (*ARRAY_FIELDS, *NUMBER_FIELDS, *TEXT_FIELDS)}
    assert declared | in_head == set(Step._fields)


def test_a_step_opens_anywhere_with_its_slices_named() -> None:
    step = made_step(2, 7)
    read = by_ros(StepEncoder("/ik_node", 7).encode(step).step, STEP_TYPE)
    sizes = {dimension.label: dimension.size for dimension in read.layout.dim}
    assert sum(sizes.values()) == len(read.data)
    begin = 0
    for label, size in sizes.items():
        if label in {field.name for field in ARRAY_FIELDS}:
            assert list(read.data[begin : begin + size]) == getattr(step, label).reshape(-1).tolist(), label
        begin += size


def test_times_beyond_the_precision_of_a_double_are_kept() -> None:
    """Epoch times in nanoseconds need 61 bits; a double has 53."""
    for nanoseconds in (0, 1, STAMP_NS, 2**62 + 1, -1):
        step = made_step(0, 6)._replace(now=Instant(nanoseconds, nanoseconds + 1), state_time_ns=nanoseconds - 1)
        texts, data = StepEncoder("", 6).encode(step)
        decoder = StepDecoder()
        assert texts is not None
        decoder.texts(texts)
        read = decoder.step(data)
        assert (read.now, read.state_time_ns) == (step.now, step.state_time_ns)


def test_a_step_without_its_texts_is_not_read_as_something_else() -> None:
    encoder, decoder = StepEncoder("", 6), StepDecoder()
    data = encoder.encode(made_step(0, 6)).step
    with pytest.raises(RecordingError, match="text record 0"):
        decoder.step(data)
    encoder.repeat_texts()
    texts, data = encoder.encode(made_step(0, 6))
    assert texts is not None
    decoder.texts(texts)
    assert decoder.step(data).tick == 0


def test_a_step_of_other_joints_is_refused_before_it_is_written() -> None:
    with pytest.raises(RecordingError, match="expected"):
        StepEncoder("", 6).encode(made_step(0, 7))


def test_calls_come_back_exactly() -> None:
    for kind in CallKind:
        call = Call(kind, 2**40 + 1, Instant(2**62 + 1, STAMP_NS))
        data = step_codec.encode_call(call)
        assert step_codec.decode_call(data) == call
        assert list(by_ros(data, "std_msgs/msg/Int64MultiArray").data) == [kind, 2**40 + 1, 2**62 + 1, STAMP_NS]
    for broken in (b"", data[:-1], data[:-32] + struct.pack("<4q", 99, 0, 0, 0)):
        with pytest.raises(RecordingError, match="call record"):
            step_codec.decode_call(broken)


def test_parameters_come_back_exactly() -> None:
    """All parameters of the package, and every parameter type with special values."""
    values: dict[str, Value] = {
        **Settings().flat(),
        "x.list": (0.1, -0.0),
        "x.names": ("a", "ü"),
        "x.empty": (),
        "x.on": True,
        "x.int": -7,
    }
    changed: dict[str, Value] = {"method": "plain", "x.list": (0.1,)}
    read = decode_parameters(encode_parameters("/ik_node", STAMP_NS, Parameters(values, changed)))
    assert same_bits(tuple(read.values.items()), tuple(values.items()))
    assert read.changed == changed
    assert Settings().with_values({name: read.values[name] for name in Settings().flat()}) == Settings()


def test_parameters_mean_the_same_to_ros() -> None:
    data = encode_parameters("/ik_node", STAMP_NS, Parameters({"rate_hz": 500.0}, {"joints": ("a",)}))
    event = by_ros(data, "rcl_interfaces/msg/ParameterEvent")
    assert event.node == "/ik_node"
    assert [(entry.name, entry.value.type, entry.value.double_value) for entry in event.new_parameters] == [
        ("rate_hz", 3, 500.0)
    ]
    assert [list(entry.value.string_array_value) for entry in event.changed_parameters] == [["a"]]

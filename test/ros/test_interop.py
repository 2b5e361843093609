"""Recordings open in other tools, and bags of other tools are valid input. Each tool is applied to a run: `rosbags`
with its converter to sqlite3, MCAP and rosbag1, `mcap_ros2`, CSV and JSON; the converted files are read again as
external bags. Not tested here: single messages (test_messages.py) and the file format (test_recording.py). The layouts
for Foxglove and PlotJuggler are compared with the topics of a recording; the programs are not started."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from loop import READY, Loop
from made_steps import quaternion_of, same_bits
from mcap_ros2.reader import read_ros2_messages
from recorded_loop import finish, recorded_loop
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from support import PROJECT, shared_path

from ik_node.cli import export
from ik_node.cli import replay as command
from ik_node.errors import InputError, RecordingError, RobotError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.step import Mode
from ik_node.math import se3
from ik_node.messages import decode, decode_targets, encode
from ik_node.messages.cdr import deserialize
from ik_node.messages.restamp import restamped
from ik_node.messages.step_codec import CallKind
from ik_node.recording.run_reader import load_run
from ik_node.replay.call_source import RecordingSource, calls
from ik_node.replay.closed_loop import simulate
from ik_node.replay.external_bag import ExternalBag
from ik_node.replay.what_if import RECORDED, metrics_of
from ik_node.report.ground_truth import ground_truth_from_targets
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

STATE, POSE = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped"
STORE2 = get_typestore(Stores.ROS2_HUMBLE)
STORE1 = get_typestore(Stores.ROS1_NOETIC)
VALUES = {"rate_hz": 100.0, "obstacles.geometry": "none"}
SETTINGS = Settings().with_values({"robot": "panda", "obstacles.geometry": "none"})


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Loop]:
    """A recorded figure of eight."""
    directory = tmp_path_factory.mktemp("interop") / "bag"
    loop = recorded_loop(directory, VALUES)
    loop.follow(figure_of_eight(loop.pose()).pose, 4.0, 50.0)
    finish(loop)
    return directory, loop


def inputs(source: Any) -> list[tuple[CallKind, int, bytes]]:
    """Return kind, ROS time and bytes of every message."""
    taken = [event for event in calls(source) if event.data and event.call.kind is not CallKind.PAUSE]
    return [(event.call.kind, event.call.now.ros_ns, event.data) for event in taken]


# --- recordings of this package in other tools ---


@pytest.mark.parametrize("arguments", [["--dst-storage", "sqlite3"], ["--dst-storage", "mcap"], ["rosbag1"]])
def test_the_converter_of_rosbags_takes_it_and_it_comes_back(
    run: tuple[Path, Loop], tmp_path: Path, arguments: list[str]
) -> None:
    directory, _ = run
    ros1 = arguments == ["rosbag1"]
    converted = tmp_path / ("run.bag" if ros1 else "run")
    typestores = ["--src-typestore", "empty"]
    call = ["rosbags-convert", "--src", str(directory), "--dst", str(converted), *(typestores if ros1 else arguments)]
    if ros1:
        call += ["--dst-typestore", "ros1_noetic", "--include-topic", "/joint_states", "/ik_node/target_pose"]
    done = subprocess.run(
        [sys.executable, "-m", "rosbags.convert", *call[1:]], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    foreign, ours = inputs(ExternalBag(converted, SETTINGS)), inputs(RecordingSource(directory))
    assert [(kind, time_ns) for kind, time_ns, _ in foreign] == [(kind, time_ns) for kind, time_ns, _ in ours]
    for (kind, _, theirs), (_, _, data) in zip(foreign, ours, strict=True):
        decoder = decode.decode_joint_state if kind is CallKind.ON_JOINT_STATE else decode_targets.decode_pose
        assert same_bits(tuple(decoder(theirs)), tuple(decoder(data)))
        if not ros1:
            assert theirs == data


def test_every_message_of_a_run_is_decoded_elsewhere(run: tuple[Path, Loop]) -> None:
    directory, loop = run
    commands = []
    for message in read_ros2_messages(str(directory / "bag_0.mcap")):
        if message.channel.topic == "/ik_node/commands":
            commands.append(list(message.ros_msg.data))
    assert commands == [step.joint_velocity.tolist() for step in loop.steps]
    with AnyReader([directory]) as reader:
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)


def test_a_run_is_exported_as_a_table(run: tuple[Path, Loop], tmp_path: Path) -> None:
    directory, loop = run
    files = [tmp_path / "run.csv", tmp_path / "run.json"]
    assert export.main([str(directory), *map(str, files)]) == 0
    with files[0].open(newline="") as file:
        rows = list(csv.DictReader(file))
    document = json.loads(files[1].read_text())
    loaded = load_run(directory)
    assert len(rows) == len(loop.steps) == len(document["columns"]["tick"])
    assert document["joints"] == list(loaded.joints)
    for index, joint in enumerate(loaded.joints):
        name = f"joint_velocity.{joint}_rad_s_m_s"
        assert [float(row[name]) for row in rows] == loaded.joint_velocity[:, index].tolist()
        assert document["columns"][name] == loaded.joint_velocity[:, index].tolist()
    assert [float(row["pose_sb.x_m"]) for row in rows] == loaded.pose_sb[:, 0, 3].tolist()
    assert document["columns"]["clearance_m"][0] is None, "values that were not computed are null"
    assert rows[0]["clearance_m"] == ""
    assert set(rows[0]) == set(document["columns"])


def test_an_export_overwrites_nothing(run: tuple[Path, Loop], tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "run.csv").write_text("mine")
    assert export.main([str(run[0]), str(tmp_path / "run.csv")]) == 2
    assert "run.csv' cannot be written: File exists" in capsys.readouterr().err
    assert (tmp_path / "run.csv").read_text() == "mine"
    assert export.main([str(run[0]), str(tmp_path / "run.xls")]) == 2
    assert "valid: .csv, .json" in capsys.readouterr().err


# --- layouts ---


def topics_and_types(directory: Path) -> dict[str, str]:
    with AnyReader([directory]) as reader:
        return {connection.topic: str(connection.msgtype) for connection in reader.connections}


def has_field(type_name: str, path: str) -> bool:
    """``twist.linear.x`` or ``velocity[0]`` in a message type."""
    fields = get_typestore(Stores.ROS2_JAZZY).fielddefs
    for part in path.split("."):
        name = part.split("[")[0]
        found = [description for field, description in fields[type_name][1] if field == name] if type_name else []
        if not found:
            return False
        kind, about = found[0]
        type_name = str(about) if int(kind) == 2 else ""  # 2: a message of another type
    return True


def test_the_foxglove_layout_shows_what_a_recording_holds(run: tuple[Path, Loop]) -> None:
    layout = json.loads((PROJECT / "config" / "foxglove_layout.json").read_text())
    topics = topics_and_types(run[0])
    paths = [path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert len(paths) > 20
    for path in paths:
        topic, _, field = path.partition(".")
        assert topic in topics, path
        assert has_field(topics[topic], field), path
    for panel in layout["configById"].values():
        named = [*panel.get("topics", ()), *(panel[key] for key in ("topicPath", "topicToRender") if key in panel)]
        assert set(named) <= set(topics)

    def panels(node: Any) -> set[str]:
        return {node} if isinstance(node, str) else panels(node["first"]) | panels(node["second"])

    assert panels(layout["layout"]) == set(layout["configById"])


def test_the_plotjuggler_layout_shows_what_a_recording_holds(run: tuple[Path, Loop]) -> None:
    """PlotJuggler names joint states by joint: topic/joint/position."""
    root = ElementTree.parse(PROJECT / "config" / "plotjuggler_layout.xml").getroot()
    curves = [curve.attrib["name"] for curve in root.iter("curve")]
    topics = topics_and_types(run[0])
    assert len(curves) > 20
    for curve in curves:
        topic = max((topic for topic in topics if curve.startswith(f"{topic}/")), key=len, default="")
        assert topic, curve
        rest = curve[len(topic) + 1 :].split("/")
        if topics[topic] == STATE:
            assert rest[0] in run[1].robot.joints
            rest = rest[1:]
        assert has_field(topics[topic], ".".join(rest)), curve


# --- bags of other tools as input ---


def test_a_foreign_bag_drives_the_controller(run: tuple[Path, Loop]) -> None:
    """A recording treated as external, with topics found by name; the arm follows its targets."""
    bag = ExternalBag(run[0], SETTINGS)
    assert bag.used["/joint_states"] == ("joint_states", 400)
    assert bag.used["/ik_node/target_pose"][0] == "target_pose"
    assert bag.initial_settings.control.rate_hz == pytest.approx(110.0, rel=0.01)
    found = metrics_of(bag, RECORDED, simulate(bag, {}), ground_truth_from_targets(bag.targets(), bag.base_frame))
    assert found.refused == 0
    assert found.position_rms_mm < 1.0
    assert found.peak_speed > 0.05
    clock = [event.call.now.ros_ns for event in calls(bag) if event.call.kind is CallKind.ON_CLOCK]
    assert set(np.diff(clock).tolist()) == {NS // 100}
    times = [event.call.now.ros_ns for event in calls(bag)]
    assert times == sorted(times)


def write_foreign(directory: Path, topics: dict[str, tuple[str, list[bytes]]], storage: Any = None) -> Path:
    """Write a rosbag2 of these topics (type, messages), 20 ms from message to message."""
    options = {"storage_plugin": storage} if storage is not None else {}
    with Writer2(directory, version=9, **options) as writer:
        for topic, (kind, data) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE2)
            for number, entry in enumerate(data):
                writer.write(connection, NS + number * 20_000_000, entry)
    return directory


def poses(loop: Loop, count: int = 100) -> list[bytes]:
    trajectory = figure_of_eight(loop.robot.pose(np.array(READY["panda"])))
    made = []
    for number in range(count):
        pose = trajectory.pose(0.02 * number)
        made.append(encode.encode_pose("panda_link0", 0, pose[:3, 3], quaternion_of(pose)))
    return made


def test_other_names_are_remapped(run: tuple[Path, Loop], tmp_path: Path) -> None:
    loop = run[1]
    state = encode.encode_joint_state(loop.robot.joints, 0, np.array(READY["panda"]))
    path = write_foreign(tmp_path / "bag", {"/arm/state": (STATE, [state] * 50), "/goal": (POSE, poses(loop))})
    with pytest.raises(RecordingError, match=r"no input of the controller.*/goal \(geometry_msgs"):
        ExternalBag(path, SETTINGS)
    bag = ExternalBag(path, SETTINGS, {"/arm/state": "joint_states", "/goal": "target_pose"})
    assert bag.used == {"/arm/state": ("joint_states", 50), "/goal": ("target_pose", 100)}
    steps = simulate(bag, {}).steps
    assert [step.status.mode for step in steps[-2:]] == [Mode.TRACKING, Mode.STOPPED], "the joint states end first"
    assert len(steps) == 51
    assert max(np.abs(step.joint_velocity).max() for step in steps) > 1e-3


def test_targets_alone_need_a_start(run: tuple[Path, Loop], tmp_path: Path) -> None:
    path = write_foreign(tmp_path / "bag", {"/x/target_pose": (POSE, poses(run[1]))})
    with pytest.raises(RecordingError, match=r"holds no joint states; give the initial positions of panda_joint1"):
        ExternalBag(path, SETTINGS)
    bag = ExternalBag(path, SETTINGS.with_values({"rate_hz": 100.0}), start=READY["panda"])
    found = metrics_of(bag, RECORDED, simulate(bag, {}), ground_truth_from_targets(bag.targets(), bag.base_frame))
    assert found.position_rms_mm < 5.0
    assert found.steps > 200


def test_a_robot_description_in_the_bag_is_the_robot(run: tuple[Path, Loop], tmp_path: Path) -> None:
    loop = run[1]
    state = encode.encode_joint_state(loop.robot.joints, 0, np.array(READY["panda"]))
    description = encode.encode_string(loop.robot.urdf)
    topics = {"/joint_states": (STATE, [state] * 20)}
    plain = write_foreign(tmp_path / "plain", topics)
    with pytest.raises(RobotError, match="no robot"):
        ExternalBag(plain, Settings())
    path = write_foreign(tmp_path / "bag", {**topics, "/robot_description": ("std_msgs/msg/String", [description])})
    bag = ExternalBag(path, Settings().with_values({"obstacles.geometry": "none"}))
    assert bag.controller().robot.joints[:7] == loop.robot.joints


def test_a_rosbag1_is_input_too(run: tuple[Path, Loop], tmp_path: Path) -> None:
    loop, path = run[1], tmp_path / "run.bag"
    header = STORE1.types["std_msgs/msg/Header"](0, STORE1.types["builtin_interfaces/msg/Time"](0, 0), "panda_link0")
    with Writer1(path) as writer:
        state = writer.add_connection("/joint_states", STATE, typestore=STORE1)
        none = np.empty(0)
        for number in range(30):
            position = np.array(READY["panda"]) + 1e-3 * number
            sample = STORE1.types[STATE](header, list(loop.robot.joints), position, none, none)
            writer.write(state, NS + number * 10_000_000, STORE1.serialize_ros1(sample, STATE))
    bag = ExternalBag(path, SETTINGS)
    found = [decode.decode_joint_state(data) for _, _, data in inputs(bag)]
    assert len(found) == 30
    assert found[7].names == loop.robot.joints
    assert same_bits(found[7].position, np.array(READY["panda"]) + 7e-3)


@pytest.mark.parametrize(
    ("remap", "reason"),
    [
        ({"/nowhere": "target_pose"}, r"has no topic /nowhere; it holds: /joint_states"),
        ({"/joint_states": "target_pose"}, r"has type sensor_msgs/msg/JointState; target_pose takes geometry_msgs"),
        ({"/joint_states": "goal"}, r"unknown input 'goal'; valid: joint_states, target_pose"),
    ],
)
def test_a_remapping_that_cannot_be_is_refused(
    run: tuple[Path, Loop], tmp_path: Path, remap: dict[str, str], reason: str
) -> None:
    state = encode.encode_joint_state(run[1].robot.joints, 0, np.array(READY["panda"]))
    path = write_foreign(tmp_path / "bag", {"/joint_states": (STATE, [state] * 2)})
    with pytest.raises(RecordingError, match=reason):
        ExternalBag(path, SETTINGS, remap)


def test_a_bag_without_anything_of_use_says_what_it_holds(tmp_path: Path, capsys: Any) -> None:
    path = write_foreign(tmp_path / "bag", {"/chatter": ("std_msgs/msg/String", [encode.encode_string("x")])})
    for arguments in ([], ["--robot", "panda"]):
        assert command.main([str(path), *arguments]) == 2
        assert "/chatter (std_msgs/msg/String, 1)" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["tf_example", "tf_example.bag"])
def test_bags_of_others_without_anything_of_use_are_refused(name: str, capsys: Any) -> None:
    path = shared_path("data", "foreign_bags", name)
    for arguments in ([], ["--robot", "panda"]):
        assert command.main([str(path), *arguments]) == 2
        assert "/tf (tf2_msgs/msg/TFMessage" in capsys.readouterr().err


def test_the_command_takes_a_foreign_bag(run: tuple[Path, Loop], tmp_path: Path, capsys: Any) -> None:
    path = write_foreign(tmp_path / "bag", {"/goal": (POSE, poses(run[1], 50))})
    arguments = [str(path), "--robot", "panda", "--remap", "/goal:=target_pose", "--jobs", "1", "--json"]
    start = ["--start", *map(str, READY["panda"])]
    quick = ["--set", "rate_hz=100", "--set", "obstacles.geometry=none"]
    assert command.main([*arguments, *start, *quick]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["closed_loop"][0]["name"] == "as configured"
    assert document["used"] == {"/goal": ["target_pose", 50]}
    assert command.main([*arguments[:3], "--remap", "/goal", *start]) == 2
    assert "expected TOPIC:=INPUT" in capsys.readouterr().err


# --- input to a running node ---


def test_stamps_move_along_and_now_stays_now() -> None:
    pose = encode.encode_pose("base", 5 * NS + 7, np.arange(3.0), np.array([0.0, 0.0, 0.0, 1.0]))
    moved = decode_targets.decode_pose(restamped(pose, POSE, 2 * NS))
    assert moved.stamp_ns == 7 * NS + 7
    assert same_bits(tuple(moved._replace(stamp_ns=0)), tuple(decode_targets.decode_pose(pose)._replace(stamp_ns=0)))
    now = encode.encode_pose("base", 0, np.arange(3.0), np.array([0.0, 0.0, 0.0, 1.0]))
    assert restamped(now, POSE, 2 * NS) == now
    with pytest.raises(InputError):
        restamped(b"nothing", POSE, 1)


def test_stamps_inside_move_too() -> None:
    """A path has a stamp at each pose."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    pose = deserialize(encode.encode_pose("base", 3 * NS, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])), POSE)
    path = jazzy.types["nav_msgs/msg/Path"](pose.header, [pose, pose])
    kind = "nav_msgs/msg/Path"
    moved: Any = deserialize(restamped(bytes(jazzy.serialize_cdr(path, kind)), kind, NS), kind)
    assert [entry.header.stamp.sec for entry in (moved, *moved.poses)] == [4, 4, 4]


def test_recorded_targets_drive_a_running_node(run: tuple[Path, Loop], tmp_path: Path) -> None:
    """--ros publishes the recorded targets, restamped, at their recorded rate, to a node that controls an arm; it
    follows."""
    ros_peer = pytest.importorskip("ros_peer")
    recorded = load_run(run[0])
    start, end = (se3.pose_from(recorded.targets.position[i], recorded.targets.quaternion_xyzw[i]) for i in (0, -1))
    width = np.ptp(recorded.targets.position[:, 1])
    assert width > 0.05
    with ros_peer.peer_in_own_domain() as peer:
        # The stream continues after an interruption by a busy machine.
        arguments = ["-p", "robot:=panda", "-p", "obstacles.geometry:=none", "-p", "target.timeout_s:=5.0"]
        peer.start("node", tmp_path, [*arguments, *ros_peer.CALM])
        arm = ros_peer.FakeArm(peer, run[1].robot, READY["panda"])
        peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
        call = [sys.executable, "-m", "ik_node.cli.replay", str(run[0]), "--ros", "--input", "target_pose", "--json"]
        environment = {**os.environ, "ROS_DOMAIN_ID": str(peer.domain)}
        places: list[float] = []

        def each() -> None:
            arm()
            places.append(arm.pose()[1, 3])

        for _ in range(10):
            peer.until("control", lambda: peer.mode == "holding", arm)
            first = len(peer.statuses)
            places = [arm.pose()[1, 3]]
            with subprocess.Popen(call, env=environment, stdout=subprocess.PIPE, text=True) as process:
                peer.until("the end", lambda process=process: process.poll() is not None, each)
                assert process.stdout is not None
                said = json.loads(process.stdout.read())
            assert process.returncode == 0
            modes = {mode for mode, _ in peer.statuses[first:]}
            if "tracking" in modes <= {"tracking", "holding"}:  # else the machine was too slow, which stopped the arm
                break
        recorded_targets = [e for e in calls(RecordingSource(run[0])) if e.call.kind is CallKind.ON_TARGET_POSE]
        assert said["target_pose"] == len(recorded_targets)
        assert said["joint_states"] == 0
        # Best effort: the last messages, 3 mm apart, may be lost.
        peer.until("arrival", lambda: bool(np.linalg.norm((arm.pose() - end)[:3, 3]) < 0.02), each)
        assert np.ptp(places) > 0.8 * width, "the arm covered the whole motion"
        assert np.linalg.norm(end[:3, 3] - start[:3, 3]) > 0.01

"""The node as a separate process over DDS, with an arm simulated by the test.

Tested: what test_controller.py checks in one process also holds with topics, services, parameters, lifecycle and
signals. Not tested here: tracking figures (test_demo.py).
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from loop import READY, make_robot
from ros_peer import CALM, FakeArm, Peer, peer_in_own_domain, rclpy
from waiting import ENOUGH_S

from ik_node.errors import RecordingError
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.robot import catalogue
from ik_node.ros import qos
from ik_node.settings.groups import describe

if rclpy:
    from geometry_msgs.msg import PoseStamped, TwistStamped
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from nav_msgs.msg import Path as PathMessage
    from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
    from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String
    from std_srvs.srv import SetBool, Trigger
    from visualization_msgs.msg import Marker, MarkerArray

PANDA = make_robot("panda")
WATCHFUL = ["-p", "state.timeout_s:=1.0"]
"""After `CALM`: missing joint states stop the arm; this process is seldom held up for as long."""
SLOW_RAMP = 0.1
"""Acceleration limit, rad/s2: the ramp to zero takes half a second, longer than a hold-up of the machine."""


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


def holding(peer: Peer, folder: Path, arguments: list[str] | None = None, robot: str = "panda") -> FakeArm:
    """A node that holds the arm."""
    peer.start("node", folder, [*CALM, "-p", f"robot:={robot}", *(arguments or [])])
    arm = FakeArm(peer, make_robot(robot), READY[robot])
    peer.until("holding", lambda: peer.mode == "holding" and bool(peer.commands), arm)
    return arm


def moving(peer: Peer, folder: Path, arguments: list[str] | None = None) -> FakeArm:
    """A node that moves to a target 10 cm away."""
    arm = holding(peer, folder, arguments)
    goal = arm.pose()
    goal[2, 3] += 0.10

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.05), each)
    return arm


def test_follows_a_target_and_holds_when_the_stream_ends(peer: Peer, tmp_path: Path) -> None:
    arm = holding(peer, tmp_path)
    goal = arm.pose()
    goal[:3, 3] += (0.0, 0.05, 0.05)

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("arrival", lambda: bool(np.abs(arm.pose() - goal).max() < 1e-3), each)
    peer.until("the end of the stream", lambda: "has ended" in peer.reason, arm)
    assert peer.mode == "holding"
    peer.until("rest at the target", lambda: bool(np.abs(arm.pose() - goal).max() < 1e-3), arm)


def test_stops_when_joint_states_stop_and_goes_on_when_they_return(peer: Peer, tmp_path: Path) -> None:
    arm = moving(peer, tmp_path, WATCHFUL)
    peer.until("zeros", lambda: not peer.commands[-1].any())
    peer.until("the reason", lambda: peer.mode == "stopped")
    # The other reason is right when the machine holds up the node at the same time; test_hold_up.py has both.
    assert peer.reason.startswith(("no joint state for 1 s", "the node was held up for"))
    peer.until_silent()  # zeros are not published endlessly
    assert not peer.commands[-1].any()
    silent = len(peer.commands)
    peer.until("holding again", lambda: peer.mode == "holding" and len(peer.commands) > silent, arm)
    assert np.abs(peer.commands[-1]).max() < 1e-6


@pytest.mark.parametrize("bad", [np.nan, pytest.param(np.inf, marks=pytest.mark.exhaustive)])
def test_a_joint_state_that_is_not_finite_stops_the_arm(peer: Peer, tmp_path: Path, bad: float) -> None:
    arm = moving(peer, tmp_path)
    position = arm.position.copy()
    position[3] = bad

    def each() -> None:
        peer.send_state(PANDA.joints, position)

    peer.until("the reason", lambda: "panda_joint4" in peer.reason, each)
    peer.until("zeros", lambda: not peer.commands[-1].any(), each)
    assert all(np.isfinite(command).all() for command in peer.commands)


def test_a_bad_target_is_refused_and_the_next_good_one_taken(peer: Peer, tmp_path: Path) -> None:
    arm = holding(peer, tmp_path)
    goal = arm.pose()
    goal[0, 3] += 0.03
    not_finite = goal.copy()
    not_finite[1, 3] = np.nan
    for pose, frame, scale, words in (
        (not_finite, "panda_link0", 1.0, "not finite"),
        (goal, "panda_link0", 0.0, "norm 0"),
        (goal, "kitchen", 1.0, "unknown frame 'kitchen'"),
    ):

        def say(pose: Array = pose, frame: str = frame, scale: float = scale) -> None:
            peer.send_target(pose, frame, scale)

        peer.until(words, lambda words=words: words in peer.reason, arm, say)  # type: ignore[misc]
        assert np.abs(peer.commands[-1]).max() < 1e-6, "the node continues to hold"

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("arrival", lambda: bool(np.abs(arm.pose() - goal).max() < 1e-3), each)
    peer.until("the reason", lambda: peer.reason.startswith("following target_pose"), each)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ramps_to_zero_and_leaves_a_whole_recording(peer: Peer, tmp_path: Path, number: int) -> None:
    bag = tmp_path / "bag"
    recording = ["-p", "recording.enabled:=true", "-p", f"recording.directory:={bag}"]
    arm = moving(peer, tmp_path, [*recording, "-p", f"limits.acceleration:=[{SLOW_RAMP}]", "-p", "rate_hz:=200.0"])
    assert peer.processes[0].stop(number, ENOUGH_S) == 0
    peer.until("the last zeros", lambda: not peer.commands[-1].any(), arm)
    run = load_run(bag)
    assert run.complete
    assert run.dropped == 0
    assert run.status[-1].reason == "the process is ending"
    assert not run.joint_velocity[-1].any()
    # From the recording: of commands that it does not read at once this process keeps the newest ones.
    first = next(row for row, status in enumerate(run.status) if status.reason == "the process is ending")
    changes = np.abs(np.diff(run.joint_velocity[first - 1 :], axis=0)).max(axis=1)
    assert len(changes) > 3, "it ramps down instead of stopping abruptly"
    assert (changes <= SLOW_RAMP * np.diff(run.times_s[first - 1 :]) + 1e-9).all()


def test_pause_reset_and_record_are_services(peer: Peer, tmp_path: Path) -> None:
    arm = moving(peer, tmp_path, ["-p", f"recording.directory:={tmp_path / 'bag'}"])
    answer = peer.call(SetBool, "/ik_node/record", SetBool.Request(data=True), arm)
    assert answer.success, answer.message
    answer = peer.call(SetBool, "/ik_node/pause", SetBool.Request(data=True), arm)
    assert answer.success
    peer.until("paused", lambda: peer.mode == "paused" and not peer.commands[-1].any(), arm)
    peer.call(SetBool, "/ik_node/pause", SetBool.Request(data=False), arm)
    peer.until("holding", lambda: peer.mode == "holding", arm)
    answer = peer.call(SetBool, "/ik_node/record", SetBool.Request(data=False), arm)
    assert "0 messages dropped" in answer.message
    # The response does not wait for the disk.
    peer.until("a whole recording", lambda: is_complete(tmp_path / "bag"), arm)
    again = peer.call(SetBool, "/ik_node/record", SetBool.Request(data=True), arm)
    assert not again.success
    assert "exists already" in again.message
    assert peer.call(Trigger, "/ik_node/reset", Trigger.Request(), arm).success


def is_complete(bag: Path) -> bool:
    """Whether a recording is complete; it cannot be read before the disk has its begin."""
    try:
        return load_run(bag).complete
    except RecordingError:
        return False


def set_doubles(peer: Peer, name: str, values: list[float], each: FakeArm) -> tuple[bool, str]:
    return set_value(
        peer, name, ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=values), each
    )


def set_double(peer: Peer, name: str, value: float, each: FakeArm) -> tuple[bool, str]:
    return set_value(peer, name, ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value), each)


def set_value(peer: Peer, name: str, typed: ParameterValue, each: FakeArm) -> tuple[bool, str]:
    request = SetParameters.Request(parameters=[Parameter(name=name, value=typed)])
    result = peer.call(SetParameters, "/ik_node/set_parameters", request, each).results[0]
    return result.successful, result.reason


def test_parameters_say_what_they_are_and_change_at_run_time(peer: Peer, tmp_path: Path) -> None:
    arm = holding(peer, tmp_path)
    names = [about.name for about in describe()]
    answer = peer.call(DescribeParameters, "/ik_node/describe_parameters", DescribeParameters.Request(names=names), arm)
    for about, descriptor in zip(describe(), answer.descriptors, strict=True):
        assert descriptor.description.startswith(about.description)
        assert about.unit in descriptor.description
        assert descriptor.read_only == about.read_only
        if isinstance(about.default, float) and about.minimum is not None:
            assert descriptor.floating_point_range[0].from_value == about.minimum
    assert set_doubles(peer, "gain", [5.0, 10.0], arm)[0]
    refused, reason = set_doubles(peer, "gain", [-1.0, 10.0], arm)
    assert not refused
    assert "gain" in reason
    refused, reason = set_double(peer, "rate_hz", 100.0, arm)
    assert not refused
    assert "read-only" in reason or "read_only" in reason
    peer.until("control", lambda: peer.mode == "holding", arm)  # a busy machine may have stopped the arm meanwhile


def test_the_values_of_all_parameters_are_one_answer(peer: Peer, tmp_path: Path) -> None:
    """What `ros2 param dump` asks for: empty lists have their type, whole numbers have become doubles."""
    arm = holding(peer, tmp_path, ["-p", "gain:=[9, 8.5]", "-p", "joints:=[]", "-p", "target.timeout_s:=1"])
    listed = peer.call(ListParameters, "/ik_node/list_parameters", ListParameters.Request(), arm).result.names
    assert {about.name for about in describe()} < set(listed)
    answer = peer.call(GetParameters, "/ik_node/get_parameters", GetParameters.Request(names=listed), arm)
    values = dict(zip(listed, answer.values, strict=True))
    assert ParameterType.PARAMETER_NOT_SET not in {value.type for value in values.values()}
    assert list(values["gain"].double_array_value) == [9.0, 8.5]
    assert values["target.timeout_s"].double_value == 1.0
    for about in describe():
        if about.default == ():
            is_text = about.element is str
            kind = ParameterType.PARAMETER_STRING_ARRAY if is_text else ParameterType.PARAMETER_DOUBLE_ARRAY
            assert values[about.name].type == kind, about.name
    whole = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=2)
    assert set_value(peer, "target.timeout_s", whole, arm) == (True, "")
    text = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="long")
    accepted, reason = set_value(peer, "target.timeout_s", text, arm)
    assert not accepted
    assert reason == "target.timeout_s is 'long' (string); valid: a double, 0.02 to 60 s"
    assert set_value(peer, "gian", whole, arm) == (False, "unknown parameter 'gian'; nearest: gain")


def test_a_file_for_another_node_and_a_missing_description_are_said(tmp_path: Path) -> None:
    with peer_in_own_domain("/left_arm") as peer:
        file = tmp_path / "p.yaml"
        file.write_text("/**:\n  ik_node:\n    ros__parameters: {robot: ur5, gain: [1, 2.5]}\n")
        process = peer.start("node", tmp_path, ["-r", "__node:=left_arm", "--params-file", str(file)])
        waiting = "waiting for robot_description on /robot_description"
        peer.until("the status", lambda: peer.reason == waiting)
        assert peer.mode == "waiting"
        log = process.log.read_text()
        assert waiting in log
        assert f"'{file}' has no parameters for node /left_arm; it has some for /**/ik_node" in log


def test_the_robot_may_come_on_the_topic_with_meshes_nobody_has(peer: Peer, tmp_path: Path) -> None:
    peer.start("node", tmp_path, [*CALM, "-p", "tip_frame:=panda_link8"])
    publisher = peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
    urdf = catalogue.read_urdf(catalogue.find("panda")).replace("package://", "package://nowhere/")
    publisher.publish(String(data=urdf))
    arm = FakeArm(peer, PANDA, READY["panda"])
    peer.until("holding", lambda: peer.mode == "holding", arm)


def test_foreign_names_remaps_and_a_namespace(tmp_path: Path) -> None:
    with peer_in_own_domain("/cell/left_ik") as peer:
        arguments = ["-r", "__ns:=/cell", "-r", "__node:=left_ik", "-r", "joint_states:=/joint_states"]
        peer.start("node", tmp_path, [*CALM, "-p", "robot:=ur5", "-p", "joint_prefix:=left_", *arguments])
        robot = make_robot("ur5")
        names = ["left_finger", *(f"left_{name}" for name in reversed(robot.joints))]
        position = [0.02, *reversed(READY["ur5"])]
        peer.until("holding", lambda: peer.mode == "holding", each=lambda: peer.send_state(names, position))


def test_a_wrong_parameter_ends_the_process_with_its_reason(peer: Peer, tmp_path: Path) -> None:
    for arguments, words in (
        (["-p", "robot:=pandora"], "unknown robot 'pandora'; valid: "),
        (["-p", "robot:=panda", "-p", "tip_frame:=nose"], "unknown frame 'nose'; valid: "),
        (["-p", "robot:=panda", "-p", "joints:=[panda_joint9]"], "unknown joint 'panda_joint9'; valid: "),
        (["-p", "robot:=panda", "-p", "limits.acceleration:=[1.0, 2.0]"], "limits.acceleration has 2 values"),
        (["-p", "robot:=panda", "-p", "rate_hz:=5.0"], "rate_hz is 5.0; valid: 10 to 2000 Hz"),
        (["-p", "robot:=panda", "-p", "gain_linear:=5.0"], "'gain_linear' was replaced by gain = [linear, angular]"),
        (["-p", "robot:=panda", "-p", "gain_liner:=5.0"], "unknown parameter 'gain_liner'; nearest: gain"),
        (["-p", "robot:=panda", "-p", "gain:=fast"], "gain is 'fast' (string); valid: a list of 2 doubles"),
        (["-p", "robot:=panda", "-p", "jog.timeout_s:=0"], "jog.timeout_s is 0.0; valid: 0.01 to 10 s"),
    ):
        process = peer.start("node", tmp_path, arguments)
        peer.until("the end of the process", lambda p=process: p.exit_code is not None)  # type: ignore[misc]
        assert process.exit_code == 1
        assert words in process.log.read_text()
        assert "Traceback" not in process.log.read_text()
    process = peer.start("node", tmp_path, ["-p", "gain:=[1, a]"])
    peer.until("the end of the process", lambda: process.exit_code is not None)
    assert process.exit_code == 2
    text = process.log.read_text()
    assert "error: arguments for ROS: Couldn't parse parameter override rule: '-p gain:=[1, a]'" in text


def test_the_lifecycle_can_be_led_from_outside(peer: Peer, tmp_path: Path) -> None:
    peer.start("node", tmp_path, [*CALM, "-p", "robot:=panda", "-p", "autostart:=false"])
    arm = FakeArm(peer, PANDA, READY["panda"])

    def change(transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(peer.call(ChangeState, "/ik_node/change_state", request, arm).success)

    def state() -> str:
        return str(peer.call(GetState, "/ik_node/get_state", GetState.Request(), arm).current_state.label)

    assert state() == "unconfigured"
    assert change(Transition.TRANSITION_CONFIGURE)
    assert state() == "inactive"  # joint states have been published meanwhile
    assert not peer.commands, "an inactive node publishes no commands"
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.until("holding", lambda: peer.mode == "holding", arm)
    goal = arm.pose()
    goal[2, 3] -= 0.10

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    peer.until("motion", lambda: bool(np.abs(peer.commands[-1]).max() > 0.05), each)
    assert change(Transition.TRANSITION_DEACTIVATE)
    peer.until_silent(each=each)
    assert not peer.commands[-1].any()
    count = len(peer.commands)
    assert change(Transition.TRANSITION_ACTIVATE)
    peer.until("holding", lambda: peer.mode == "holding" and len(peer.commands) > count, arm)
    assert np.abs(peer.commands[-1]).max() < 1e-6, "the target is the present pose"
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert change(Transition.TRANSITION_CLEANUP)
    assert state() == "unconfigured"


def test_paths_twists_and_obstacles_arrive_as_messages(peer: Peer, tmp_path: Path) -> None:
    arm = holding(peer, tmp_path)
    paths = peer.node.create_publisher(PathMessage, "/ik_node/target_path", qos.OUTPUT)
    twists = peer.node.create_publisher(TwistStamped, "/ik_node/target_twist", qos.OUTPUT)
    obstacles = peer.node.create_publisher(MarkerArray, "/ik_node/obstacles", qos.OUTPUT)
    begin = arm.pose()

    def send_path() -> None:
        path = PathMessage()
        start_ns = peer.node.get_clock().now().nanoseconds + 500_000_000
        for index in range(5):
            stamped = PoseStamped()
            stamped.header.frame_id = "panda_link0"
            stamp_ns = start_ns + index * 400_000_000
            stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
            p, q = stamped.pose.position, stamped.pose.orientation
            p.x, p.y, p.z = (begin[:3, 3] + (0.0, 0.02 * index, 0.0)).tolist()
            q.x, q.y, q.z, q.w = se3.quaternion_from_rotation(begin[:3, :3]).tolist()
            path.poses.append(stamped)
        paths.publish(path)

    peer.until("the path", lambda: "following target_path" in peer.reason, arm, send_path)
    peer.until("its end", lambda: "target_path has ended" in peer.reason, arm)
    peer.until("rest at its end", lambda: bool(abs(arm.pose()[1, 3] - begin[1, 3] - 0.08) < 2e-3), arm)

    twist = TwistStamped()
    twist.header.frame_id = "panda_link0"
    twist.twist.linear.z = 0.05

    def jog() -> None:
        arm()
        twists.publish(twist)

    height = arm.pose()[2, 3]
    peer.until("jogging", lambda: "jogging by target_twist" in peer.reason, jog)
    peer.until("motion", lambda: bool(arm.pose()[2, 3] > height + 0.03), jog)
    peer.until("rest", lambda: "target_twist has ended" in peer.reason, arm)

    marker = Marker()
    marker.header.frame_id = "nowhere"
    marker.type, marker.ns = Marker.SPHERE, "test"
    marker.scale.x = marker.scale.y = marker.scale.z = 0.1

    def send_obstacle() -> None:
        obstacles.publish(MarkerArray(markers=[marker]))

    peer.until("the refusal", lambda: "test/0: unknown frame 'nowhere'" in peer.reason, arm, send_obstacle)
    marker.header.frame_id = "panda_link0"
    peer.until("a valid obstacle", lambda: "refused" not in peer.reason, arm, send_obstacle)


def test_two_who_publish_targets_are_noticed(peer: Peer, tmp_path: Path) -> None:
    """The status names both publishers within seconds, until one of them leaves. Two publishers of joint_states are not
    reported."""
    arm = holding(peer, tmp_path)
    other = peer.node.create_publisher(PoseStamped, "/ik_node/target_pose", qos.STREAM)
    driver = peer.node.create_publisher(JointState, "/joint_states", qos.STREAM)
    peer.until("the warning of two publishers", lambda: "2 publishers on target_pose" in peer.reason, arm)
    assert "joint_states" not in peer.reason
    peer.node.destroy_publisher(other)
    peer.until("one publisher", lambda: "publishers" not in peer.reason, arm)
    peer.node.destroy_publisher(driver)


def test_the_run_is_shown_as_markers_to_those_who_look(peer: Peer, tmp_path: Path) -> None:
    """Tool path, target, and an obstacle with its distance; the obstacle disappears when it is deleted, and all markers
    disappear when the node ends."""
    arm = moving(peer, tmp_path)
    goal = arm.pose()
    goal[2, 3] -= 0.10
    shown: dict[tuple[str, int], Marker] = {}
    stamps_s: list[float] = []

    def on_markers(message: MarkerArray) -> None:
        stamps_s.extend(m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in message.markers[:1])
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                shown.clear()
            elif marker.action == Marker.DELETE:
                shown.pop((marker.ns, marker.id), None)
            else:
                shown[marker.ns, marker.id] = marker

    def each() -> None:
        arm()
        peer.send_target(goal, "panda_link0")

    def there() -> set[str]:
        return {ns for ns, _ in shown}

    peer.node.create_subscription(MarkerArray, "/ik_node/markers", on_markers, qos.OUTPUT)
    peer.until("path and target", lambda: {"tool_path", "target"} <= there(), each)
    assert "obstacles" not in there()
    obstacles = peer.node.create_publisher(MarkerArray, "/ik_node/obstacles", qos.OUTPUT)
    marker = Marker(ns="test", id=3, type=Marker.SPHERE)
    marker.header.frame_id = "panda_link0"
    marker.scale.x = marker.scale.y = marker.scale.z = 0.1
    marker.pose.position.x, marker.pose.position.z = 0.2, 1.1

    def send_obstacle() -> None:
        obstacles.publish(MarkerArray(markers=[marker]))

    peer.until("the obstacle", lambda: "obstacles" in there(), each, send_obstacle)
    (ball,) = (entry for (ns, _), entry in shown.items() if ns == "obstacles")
    assert (ball.header.frame_id, ball.scale.x, ball.pose.position.z) == ("panda_link0", 0.1, 1.1)
    peer.until("the clearance", lambda: ("clearance", 1) in shown and "mm" in shown["clearance", 1].text, each)
    peer.until("more of them", lambda: len(stamps_s) >= 20, each)
    assert stamps_s[-1] - stamps_s[0] > 0.05 * len(stamps_s), "a tenth of the control rate, for any timing of the steps"
    marker.action = Marker.DELETE
    peer.until("its end", lambda: "obstacles" not in there(), each, send_obstacle)
    peer.processes[0].stop(signal.SIGINT, ENOUGH_S)
    peer.until("no markers", lambda: not shown)

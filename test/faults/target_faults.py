"""Faults of targets and obstacles: poses of the stream, paths, trajectories, twists, markers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from fault import GOES_ON, HOLDS, PAUSED, Fault, Right
from rig import Rig
from ros_peer import rclpy

from ik_node.messages.decode_obstacles import MAX_MARKERS
from ik_node.ros import qos

if rclpy:
    from builtin_interfaces.msg import Duration
    from geometry_msgs.msg import PoseStamped, Transform, Twist, TwistStamped
    from nav_msgs.msg import Path
    from rclpy.serialization import serialize_message
    from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
    from visualization_msgs.msg import Marker, MarkerArray

FRAME = "panda_link0"
Change = Callable[[Any, Rig], Any]


# --- the stream ------------------------------------------------------------------------------------------------------


def every(change: Change) -> Callable[[Rig], None]:
    """A cause that changes every target pose."""

    def cause(rig: Rig) -> None:
        def altered(message: Any) -> tuple[Any, ...]:
            change(message, rig)
            return (message,)

        rig.targets = altered

    return cause


def position(x: float) -> Change:
    def change(message: Any, rig: Rig) -> None:
        message.pose.position.x = x

    return change


def orientation(*xyzw: float) -> Change:
    def change(message: Any, rig: Rig) -> None:
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = xyzw

    return change


def frame(name: str) -> Change:
    def change(message: Any, rig: Rig) -> None:
        message.header.frame_id = name

    return change


def aged(age_s: float) -> Change:
    def change(message: Any, rig: Rig) -> None:
        message.header.stamp = rig.stamp(age_s)

    return change


def ends(rig: Rig) -> None:
    rig.targets = lambda message: ()


def frozen(rig: Rig) -> None:
    kept = rig.pose_message()
    rig.targets = lambda message: (kept,)


def cut_off(rig: Rig) -> None:
    rig.targets = lambda message: (bytes(serialize_message(message))[:-20],)


def alternating(x: float) -> Callable[[Rig], None]:
    """A cause: every second pose is at ``x`` m."""

    def cause(rig: Rig) -> None:
        def altered(message: Any) -> tuple[Any, ...]:
            bad = rig.pose_message()
            bad.pose.position.x = x
            return message, bad

        rig.targets = altered

    return cause


def jump(rig: Rig) -> None:
    """The target jumps by 0.3 m and back, ten times a second."""
    count = [0]

    def altered(message: Any) -> tuple[Any, ...]:
        count[0] += 1
        message.pose.position.y += 0.3 * (count[0] // 5 % 2)
        return (message,)

    rig.targets = altered


def second_publisher(rig: Rig) -> None:
    other = rig.peer.node.create_publisher(PoseStamped, "/ik_node/target_pose", qos.OUTPUT)
    rig.until(lambda: "2 publishers" in rig.peer.reason)
    rig.peer.node.destroy_publisher(other)


# --- paths, trajectories, twists -------------------------------------------------------------------------------------


def send(
    topic: str, kind: Callable[[], Any], make: Callable[[Rig], Any], takes_long: bool = False
) -> Callable[[Rig], None]:
    """A cause: one message on another topic beside the good stream; the arm is paused while a long one is made."""

    def cause(rig: Rig) -> None:
        rig.publish(f"/ik_node/{topic}", kind(), None)
        if takes_long:  # no joint states are sent while the message is made
            rig.pause()
            rig.until(lambda: rig.peer.mode == PAUSED)
        message = bytes(serialize_message(make(rig)))
        if takes_long:
            rig.spin(0.1)
            rig.pause(False)
            rig.until_moving()
            rig.answer = ""
        rig.mark()
        rig.publish(f"/ik_node/{topic}", kind(), message)

    return cause


def path(change: Callable[[Any], Any], count: int = 5) -> Callable[[Rig], None]:
    """A cause: a path that is changed."""

    def make(rig: Rig) -> Any:
        message = Path()
        message.header.frame_id = FRAME
        pose = rig.pose_message()
        pose.header.stamp.sec = pose.header.stamp.nanosec = 0
        if count > 100:
            message.poses = [pose] * count
        else:
            for number in range(count):
                added = rig.pose_message()
                added.header.stamp.sec = added.header.stamp.nanosec = 0
                added.pose.position.y += 0.01 * number
                message.poses.append(added)
        change(message)
        return message

    return send("target_path", lambda: Path, make, count > 100)


def trajectory(change: Callable[[Any], Any]) -> Callable[[Rig], None]:
    """A cause: a trajectory of five points that is changed."""

    def make(rig: Rig) -> Any:
        message = MultiDOFJointTrajectory(joint_names=["tool"])
        message.header.frame_id = FRAME
        for number in range(5):
            point, start = MultiDOFJointTrajectoryPoint(), rig.pose_message().pose
            transform = Transform(rotation=start.orientation)
            t = transform.translation
            t.x, t.y, t.z = start.position.x, start.position.y + 0.01 * number, start.position.z
            point.transforms, point.velocities = [transform], [Twist()]
            point.time_from_start = Duration(sec=number)
            message.points.append(point)
        change(message)
        return message

    return send("target_trajectory", lambda: MultiDOFJointTrajectory, make)


def twist(x: float, frame_id: str = FRAME) -> Callable[[Rig], None]:
    """A cause: twists, as often as joint states; a single one may be lost, as the node receives them best-effort."""

    def cause(rig: Rig) -> None:
        message = TwistStamped()
        message.header.frame_id, message.header.stamp = frame_id, rig.stamp()
        message.twist.linear.x = x
        rig.publish("/ik_node/target_twist", TwistStamped, None)
        rig.mark()
        rig.each = lambda: rig.publish("/ik_node/target_twist", TwistStamped, message)

    return cause


def set_pose(number: int, x: float) -> Callable[[Any], None]:
    def change(message: Any) -> None:
        message.poses[number].pose.position.x = x

    return change


def same_times(message: Any) -> None:
    for pose, time_s in zip(message.poses, (1, 2, 2, 3, 4), strict=True):
        pose.header.stamp.sec = 1_700_000_000 + time_s


def unknown_frame(message: Any) -> None:
    message.poses[2].header.frame_id = "kitchen"


def no_poses(message: Any) -> None:
    message.poses = []


def no_transform(message: Any) -> None:
    message.points[2].transforms = []


def nan_twist(message: Any) -> None:
    message.points[3].velocities[0].linear.y = np.nan


def zero_times(message: Any) -> None:
    for point in message.points:
        point.time_from_start = Duration()


# --- obstacles -------------------------------------------------------------------------------------------------------


def marker(kind: int = 2, namespace: str = "fault", number: int = 0, x: float = 1.5, **fields: Any) -> Any:
    """A marker 1.5 m in front of the base."""
    found = Marker(ns=namespace, id=number, type=kind, **fields)
    found.header.frame_id = FRAME
    found.scale.x = found.scale.y = found.scale.z = 0.05
    found.pose.position.x, found.pose.position.z = x, 0.5
    found.pose.orientation.w = 1.0
    return found


def obstacles(make: Callable[[Rig], list[Any]], takes_long: bool = False) -> Callable[[Rig], None]:
    """A cause: one message of markers."""
    return send("obstacles", lambda: MarkerArray, lambda rig: MarkerArray(markers=make(rig)), takes_long)


def spheres(count: int) -> Callable[[Rig], None]:
    return obstacles(
        lambda rig: [marker(number=number, x=1.5 + 0.001 * number) for number in range(count)], count > 100
    )


def one(change: Callable[[Any], Any], kind: int = 2) -> Callable[[Rig], None]:
    """A cause: one marker that is changed."""

    def make(rig: Rig) -> list[Any]:
        found = marker(kind)
        change(found)
        return [found]

    return obstacles(make)


def delete_all(rig: Rig, namespace: str = "") -> None:
    """The way back from obstacles."""
    rig.publish("/ik_node/obstacles", MarkerArray, MarkerArray(markers=[marker(namespace=namespace, action=3)]))


def field(name: str, part: str, value: float) -> Callable[[Any], None]:
    """Sets ``part`` of a vector of a marker."""

    def change(message: Any) -> None:
        owner = message.scale if name == "scale" else getattr(message.pose, name)
        setattr(owner, part, value)

    return change


def no_orientation(message: Any) -> None:
    message.pose.orientation.w = 0.0


def kitchen(message: Any) -> None:
    message.header.frame_id = "kitchen"


def wall(rig: Rig, namespace: str) -> Any:
    """A wall 3 cm beside the path of the tool, which the target crosses."""
    found = marker(1, namespace)
    centre = rig.centre[:3, 3]
    found.pose.position.x, found.pose.position.y, found.pose.position.z = centre[0], centre[1] + 0.16, centre[2]
    found.scale.x, found.scale.y, found.scale.z = 0.4, 0.05, 0.6
    return found


def behind_a_wall(namespace: str) -> Callable[[Rig], None]:
    """A cause: a wall of one namespace; DELETEALL of another one or of its own; the target is behind the wall."""

    def cause(rig: Rig) -> None:
        rig.publish("/ik_node/obstacles", MarkerArray, MarkerArray(markers=[wall(rig, "human")]))
        rig.spin(0.3)
        delete_all(rig, namespace)

        def beyond(message: Any) -> tuple[Any, ...]:
            message.pose.position.y = float(rig.centre[1, 3]) + 0.3
            return (message,)

        rig.targets = beyond
        rig.mark()
        rig.spin(3.0)
        y = rig.robot.pose(rig.position)[1, 3] - rig.centre[1, 3]
        rig.answer = "the tool is behind the wall" if y > 0.16 else "the tool is in front of the wall"

    return cause


REFUSED = Right(HOLDS, "", 2.0)
"""The bad poses replace the good ones: the stream has ended, and the arm holds."""


def refused(text: str) -> Right:
    return REFUSED._replace(text=text)


TARGET_FAULTS = (
    Fault("target stream ends", ends, Right(HOLDS, "has ended", 2.0)),
    Fault("target repeated with its old stamp", frozen, Right(HOLDS, "", 2.0)),
    Fault("target NaN", every(position(np.nan)), refused("not finite")),
    Fault("target inf", every(position(np.inf)), refused("not finite")),
    Fault("target 101 m away", every(position(101.0)), refused("more than 100 m away"), "F06"),
    Fault("target 1e6 m away", every(position(1e6)), refused("more than 100 m away"), "F06"),
    Fault("target 1e160 m away", every(position(1e160)), refused("more than 100 m away"), "F06"),
    Fault("target 1e308 m away", every(position(1e308)), refused("more than 100 m away"), "F06"),
    Fault("every second target 1e6 m away", alternating(1e6), Right(text="more than 100 m away"), "F06"),
    Fault("target 5 m away, out of reach", every(position(5.0)), Right(text="out of reach")),
    Fault("target with quaternion 0", every(orientation(0.0, 0.0, 0.0, 0.0)), refused("norm 0")),
    Fault("target with quaternion of norm 2", every(orientation(0.0, 2.0, 0.0, 0.0)), refused("norm 2")),
    Fault("target with quaternion NaN", every(orientation(np.nan, 0.0, 0.0, 1.0)), refused("not finite")),
    Fault("target in an unknown frame", every(frame("kitchen")), refused("unknown frame 'kitchen'")),
    Fault("target with a frame of 100 kB", every(frame("f" * 100_000)), refused("bytes; at most")),
    Fault("target bytes cut off", cut_off, refused("target_pose refused")),
    Fault("target stamps 10 s old", every(aged(10.0)), Right(text="target stamps disagree with this clock")),
    Fault("target stamps 10 s ahead", every(aged(-10.0)), Right(text="target stamps disagree with this clock")),
    Fault("target jumps by 0.3 m", jump, Right()),
    Fault("two publishers of targets", second_publisher, Right(text="2 publishers on target_pose")),
    Fault("path with a pose NaN", path(set_pose(4, np.nan)), Right(text="pose 4")),
    Fault("path with a pose 1e6 m away", path(set_pose(4, 1e6)), Right(text="pose 4")),
    Fault("path with two times alike", path(same_times), Right(text="pose 2 is not later than pose 1")),
    Fault("path with an unknown frame", path(unknown_frame), Right(text="pose 2: unknown frame")),
    Fault("path without poses", path(no_poses), Right(text="a path of 0 poses")),
    Fault("path of 3,000 poses", path(lambda message: None, 3000), Right(text="3000 poses; at most 2000"), "F13"),
    Fault("path of 100,000 poses", path(lambda message: None, 100_000), Right(text="100000 poses"), "F13"),
    Fault("trajectory point without a transform", trajectory(no_transform), Right(text="0 transforms"), "F+"),
    Fault("trajectory with a twist NaN", trajectory(nan_twist), Right(text="velocity of pose 3 is not finite")),
    Fault("trajectory with times 0", trajectory(zero_times), Right(text="pose 1 is not later than pose 0")),
    Fault("twist NaN", twist(np.nan), Right(text="target twist is not finite")),
    Fault("twist of 1e6 m/s", twist(1e6), Right(text="target twist is")),
    Fault("twist in an unknown frame", twist(0.01, "kitchen"), Right(text="target_twist refused: unknown frame")),
)

MARKERS = Right(GOES_ON, "obstacle")
KINDS = {0: "ARROW", 4: "LINE_STRIP", 5: "LINE_LIST", 6: "CUBE_LIST", 7: "SPHERE_LIST", 8: "POINTS"}
KINDS |= {9: "TEXT_VIEW_FACING", 10: "MESH_RESOURCE", 11: "TRIANGLE_LIST", 12: "ARROW_STRIP", 99: "marker type 99"}

OBSTACLE_FAULTS = (
    *(
        Fault(f"marker {name}", one(lambda message: None, kind), Right(text=name), "W01", delete_all)
        for kind, name in KINDS.items()
    ),
    Fault("sphere without orientation", one(no_orientation), Right(), "W01", delete_all),
    Fault("cube without orientation", one(no_orientation, 1), Right(text="norm 0"), "", delete_all),
    Fault("sphere with position NaN", one(field("position", "x", np.nan)), MARKERS, "", delete_all),
    Fault("sphere with scale NaN", one(field("scale", "x", np.nan), 1), MARKERS, "", delete_all),
    Fault("sphere 1e160 m away", one(field("position", "x", 1e160)), MARKERS, "", delete_all),
    Fault("cube of scale 0", one(field("scale", "y", 0.0), 1), MARKERS, "", delete_all),
    Fault("cube of scale -1", one(field("scale", "y", -1.0), 1), MARKERS, "", delete_all),
    Fault("marker in an unknown frame", one(kitchen), Right(text="kitchen"), "", delete_all),
    Fault(f"{MAX_MARKERS} spheres", spheres(MAX_MARKERS), Right(), "F01", delete_all),
    Fault("10,000 spheres", spheres(10_000), Right(text=f"10000 markers; at most {MAX_MARKERS}"), "F01", delete_all),
    Fault(
        "DELETEALL of another namespace", behind_a_wall("table"), Right(text="in front of the wall"), "W01", delete_all
    ),
    Fault("DELETEALL of its namespace", behind_a_wall("human"), Right(text="behind the wall"), "W01", delete_all),
)

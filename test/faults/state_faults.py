"""Faults of joint states and of the arm itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from fault import HOLDS, STOPPED, TIMEOUT_S, Fault, Right
from rig import Rig
from ros_peer import rclpy

from ik_node.ros import qos

if rclpy:
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import JointState

Change = Callable[[Any, Rig], Any]
"""Changes a message in place."""
AT_ONCE = 0.05
ELBOW = "panda_joint4"


def after_outliers(rig: Rig) -> None:
    """Two outliers within a second are a contradiction; waits until the last one is older."""
    rig.spin(1.2)
    rig.until_moving()
    rig.mark()


def every(change: Change, is_outlier: bool = False) -> Callable[[Rig], None]:
    """A cause that changes every joint state; an outlier begins well after the last one."""

    def cause(rig: Rig) -> None:
        if is_outlier:
            after_outliers(rig)

        def altered(message: Any) -> tuple[Any, ...]:
            change(message, rig)
            return (message,)

        rig.states = altered

    return cause


def set_position(joint: int, value: float) -> Change:
    """Sets the position of a joint."""

    def change(message: Any, rig: Rig) -> None:
        message.position[joint] = value

    return change


def add_position(joint: int, value: float) -> Change:
    """Adds to the position of a joint."""

    def change(message: Any, rig: Rig) -> None:
        message.position[joint] += value

    return change


def once(joint: int, value: float) -> Callable[[Rig], None]:
    """A cause: one joint state in which a joint has another position."""

    def cause(rig: Rig) -> None:
        after_outliers(rig)
        left = [1]

        def altered(message: Any) -> tuple[Any, ...]:
            if left:
                left.pop()
                message.position[joint] += value
            return (message,)

        rig.states = altered

    return cause


def repeatedly(rig: Rig) -> None:
    """Every tenth joint state has another position."""
    count = [0]

    def altered(message: Any) -> tuple[Any, ...]:
        count[0] += 1
        if count[0] % 10 == 0:
            message.position[1] += 1.5
        return (message,)

    rig.states = altered


def second_publisher(rig: Rig) -> None:
    """Another node publishes zeros at 10 Hz, as joint_state_publisher does."""
    publisher = rig.peer.node.create_publisher(JointState, "/joint_states", qos.OUTPUT)
    rig.until(lambda: publisher.get_subscription_count() > 0)
    count = [0]

    def each() -> None:
        count[0] += 1
        if count[0] % 10 == 0:
            message = JointState(name=list(rig.robot.joints), position=[0.0] * rig.robot.n)
            message.header.stamp = rig.stamp()
            publisher.publish(message)

    rig.mark()
    rig.each = each


def silence(rig: Rig) -> None:
    """No more joint states."""
    rig.states = lambda message: ()


def only(number: int) -> Callable[[Rig], None]:
    """A cause: every n-th joint state only."""

    def cause(rig: Rig) -> None:
        rig.states_every = number

    return cause


def truncated(rig: Rig) -> None:
    """The bytes of every joint state are cut off."""
    rig.states = lambda message: (bytes(serialize_message(message))[:-60],)


def split(rig: Rig) -> None:
    """Each joint state comes in two messages."""

    def halves(message: Any) -> tuple[Any, ...]:
        other = JointState(header=message.header, name=message.name[3:], position=message.position[3:])
        message.name, message.position = message.name[:3], message.position[:3]
        return message, other

    rig.states = halves


def with_wheels(rig: Rig) -> None:
    """A wheel driver publishes velocities without positions on the same topic."""
    wheels = JointState(name=["wheel_left", "wheel_right"], velocity=[1.0, 1.0])
    rig.states = lambda message: (wheels, message)


def repeated(rig: Rig) -> None:
    """The driver repeats its last message."""
    kept: list[Any] = []

    def altered(message: Any) -> tuple[Any, ...]:
        kept.append(message)
        return (kept[0],)

    rig.states = altered


def aged(age_s: float) -> Change:
    """Sets the stamp to the time of ``age_s`` ago."""

    def change(message: Any, rig: Rig) -> None:
        message.header.stamp = rig.stamp(age_s)

    return change


def stamp_zero(message: Any, rig: Rig) -> None:
    message.header.stamp.sec = message.header.stamp.nanosec = 0


def swap(message: Any, rig: Rig) -> None:
    message.name.reverse()
    message.position = message.position[::-1]


def drop_elbow(message: Any, rig: Rig) -> None:
    message.name.pop(3)
    message.position = [*message.position[:3], *message.position[4:]]


def drop_position(message: Any, rig: Rig) -> None:
    message.position = message.position[:-1]


def drop_name(message: Any, rig: Rig) -> None:
    message.name.pop()


def no_positions(message: Any, rig: Rig) -> None:
    message.velocity, message.position = list(message.position), []


def empty(message: Any, rig: Rig) -> None:
    message.name, message.position = [], []


def twice(value: float | None) -> Change:
    """Names the elbow once more, at another position or at the same one."""

    def change(message: Any, rig: Rig) -> None:
        message.name.append(ELBOW)
        message.position.append(message.position[3] if value is None else value)

    return change


def others(count: int) -> Change:
    """Adds joints that are not controlled."""

    def change(message: Any, rig: Rig) -> None:
        message.name.extend(f"other_{number}" for number in range(count))
        message.position.extend([np.nan] * count)

    return change


def velocities(message: Any, rig: Rig) -> None:
    message.velocity = message.effort = [np.nan] * rig.robot.n


def renamed(message: Any, rig: Rig) -> None:
    message.name = [f"left_{name}" for name in message.name]


def ratio(value: float) -> Callable[[Rig], None]:
    """A cause: the arm moves by this ratio of its commands."""

    def cause(rig: Rig) -> None:
        rig.obeys = lambda command: value * command

    return cause


def pushed(rig: Rig) -> None:
    """The target has ended, and the arm moves although none of its joints is commanded to."""
    rig.targets = lambda message: ()
    rig.until(lambda: rig.peer.mode == HOLDS and not rig.moving)
    rig.mark()
    rig.obeys = lambda command: np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5])


STALE = Right(STOPPED, f"no joint state for {TIMEOUT_S:g} s", TIMEOUT_S, at_once=True)
REFUSED = Right(STOPPED, "", AT_ONCE, at_once=True)
IGNORED = Right(STOPPED, "", TIMEOUT_S, at_once=True)
RAMPED = Right(STOPPED, "", 2.5)


def at_once(text: str) -> Right:
    return REFUSED._replace(text=text)


def ignored(text: str) -> Right:
    return IGNORED._replace(text=text)


STATE_FAULTS = (
    Fault("joint states stop", silence, STALE),
    Fault(
        "joint states at a tenth of the rate", only(10), RAMPED._replace(text="joint states arrive slower than 30 Hz")
    ),
    Fault("position NaN", every(set_position(3, np.nan)), at_once(f"not finite for {ELBOW}")),
    Fault("position inf", every(set_position(0, np.inf)), at_once("not finite for panda_joint1")),
    Fault("position -inf", every(set_position(6, -np.inf)), at_once("not finite for panda_joint7")),
    Fault("velocities and efforts NaN", every(velocities), Right()),
    Fault("one position 3 rad off", once(1, 3.0), Right(text="joint state ignored"), "F07"),
    Fault("one position 0.8 rad off", once(1, 0.8), Right(text="joint 'panda_joint2' jumped"), "F07"),
    Fault("one position 1e6 rad off", once(1, 1e6), Right(text="joint 'panda_joint2' is far outside"), "F07"),
    Fault("one position 1e308 rad off", once(1, 1e308), Right(text="joint 'panda_joint2' is far outside"), "F07"),
    Fault(
        "all positions of joint 2 at 1e308",
        every(set_position(1, 1e308), True),
        ignored("far outside its limits"),
        "F07",
    ),
    Fault(
        "joint 4 at +3 rad, outside its limits", every(set_position(3, 3.0), True), ignored("far outside its limits")
    ),
    Fault(
        "joint 2 jumps by 0.8 rad and stays", every(add_position(1, 0.8), True), ignored("joint 'panda_joint2' jumped")
    ),
    Fault("every tenth position 1.5 rad off", repeatedly, Right(STOPPED, "contradict", 0.3, at_once=True), "W03"),
    Fault("second publisher: zeros at 10 Hz", second_publisher, Right(STOPPED, "contradict", 0.4, at_once=True), "W03"),
    Fault("joint named twice, at 1.6 rad", every(twice(1.6), True), ignored(f"joint '{ELBOW}' stands twice"), "W04"),
    Fault("joint named twice, at one position", every(twice(None)), Right(), "W04"),
    Fault("joint missing while moving", every(drop_elbow), ignored(f"of {ELBOW}"), "F+"),
    Fault("joints in another order", every(swap), Right()),
    Fault("joints under other names", every(renamed), STALE),
    Fault("eight other joints, NaN", every(others(8)), Right()),
    Fault("300 joints", every(others(293)), ignored("300")),
    Fault("a message without a position", every(drop_position), at_once("7 names but 6 positions")),
    Fault("a position without a name", every(drop_name), at_once("6 names but 7 positions")),
    Fault("positions empty, velocities given", every(no_positions), STALE, "W02"),
    Fault("wheels' velocities on the same topic", with_wheels, Right(), "W02"),
    Fault("empty messages", every(empty), STALE),
    Fault("bytes cut off", truncated, STALE),
    Fault("one message in two parts", split, Right()),
    Fault("last message repeated", repeated, RAMPED._replace(text="the robot does not move")),
    Fault("stamps 10 s old", every(aged(10.0)), Right(text="joint state stamps disagree with this clock")),
    Fault("stamps 10 s ahead", every(aged(-10.0)), Right(text="joint state stamps disagree with this clock")),
    Fault("stamps 0", every(stamp_zero), Right()),
    Fault("arm stands (protective stop)", ratio(0.0), RAMPED._replace(text="the robot does not move")),
    Fault("arm at 0.3 of its speed", ratio(0.3), RAMPED._replace(text="moves less than commanded")),
    Fault("arm moves against its commands", ratio(-1.0), RAMPED._replace(text="moves by itself")),
    Fault("arm is pushed while it holds", pushed, RAMPED._replace(text="moves by itself")),
)

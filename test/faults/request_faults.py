"""Faults of requests while the arm moves: parameters, services, transitions, descriptions, the hang of the process."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Any

import numpy as np
from fault import PAUSED, STOPPED, UNPAUSE, Fault, Right
from rig import Rig
from ros_peer import rclpy

from ik_node.ros import qos

if rclpy:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState
    from std_msgs.msg import Float64MultiArray, String
    from std_srvs.srv import SetBool


def setting(**values: Any) -> Callable[[Rig], None]:
    """A cause or the way back from it: parameters are set."""
    return lambda rig: rig.set(**values)


def refused(name: str, value: Any, text: str, case: str = "") -> Fault:
    """A parameter value that has to be refused with a text; the arm continues to follow its target."""
    shown = value if not isinstance(value, (list, tuple)) else list(value)
    return Fault(f"{name.replace('__', '.')} = {shown!r}", setting(**{name: value}), Right(text=text), case)


def accepted(name: str, value: Any, before: Any, case: str = "") -> Fault:
    """A parameter value that is accepted; the arm continues to follow its target."""
    shown = value if not isinstance(value, (list, tuple)) else list(value)
    label = f"{name.replace('__', '.')} = {shown!r}"
    return Fault(label, setting(**{name: value}), Right(), case, setting(**{name: before}))


def pause(rig: Rig) -> None:
    rig.pause()


def pause_and_lower(rig: Rig) -> None:
    """The ramp of a pause is made long; a velocity limit below the present speed arrives in it."""
    rig.set(limits__acceleration=[0.4])
    rig.mark()
    rig.pause()
    rig.set(limits__velocity_fraction=0.02)


def pause_and_lower_acceleration(rig: Rig) -> None:
    rig.pause()
    rig.set(limits__acceleration=[0.4])


def restore_limits(rig: Rig) -> None:
    rig.set(limits__acceleration=[4.0], limits__velocity_fraction=1.0)


def pause_and_silence(rig: Rig) -> None:
    """The joint states end in the ramp of a pause, which is completed without them."""
    rig.set(limits__acceleration=[0.4])
    rig.mark()
    rig.pause()
    rig.states = lambda message: ()


def reset(rig: Rig) -> None:
    rig.reset()


def outside_position_limits(rig: Rig) -> None:
    """Position limits are set so that joint 2 is outside, where the arm is."""
    upper = [2.8973, float(rig.position[1]) - 0.1, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]
    rig.set(limits__position_upper=upper)


def no_position_limits(rig: Rig) -> None:
    rig.set(limits__position_upper=[2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])


def transition(number: int) -> Callable[[Rig], None]:
    def change(rig: Rig) -> None:
        request = ChangeState.Request(transition=Transition(id=number))
        rig.peer.call(ChangeState, "/ik_node/change_state", request, rig.tick)

    return change


def no_subscriber(rig: Rig) -> None:
    """The only subscription to the commands ends; it is created again after the status is known."""
    node = rig.peer.node
    found = [entry for entry in node.subscriptions if entry.topic_name == "/ik_node/commands"]
    for entry in found:
        node.destroy_subscription(entry)
    rig.until(lambda: rig.peer.mode == STOPPED)
    rig.peer.commands.append(np.zeros(rig.robot.n))
    rig.peer.command_times_ns.append(rig.fault_ns)


def subscribe_again(rig: Rig) -> None:
    rig.peer.subscribe_commands()


def other_commander(rig: Rig) -> None:
    """Another node publishes a command on the same topic once; the arm obeys it until the next one."""
    other = rig.peer.node.create_publisher(Float64MultiArray, "/ik_node/commands", qos.COMMAND)
    rig.until(lambda: other.get_subscription_count() > 0)
    other.publish(Float64MultiArray(data=[0.01] * rig.robot.n))
    rig.spin(0.1)
    rig.peer.node.destroy_publisher(other)


def other_description(rig: Rig) -> None:
    publisher = rig.peer.node.create_publisher(String, "/robot_description", qos.LATCHED)
    publisher.publish(String(data=rig.robot.urdf.replace("panda", "other")))
    rig.until(lambda: "another robot_description" in rig.peer.reason)
    publisher.publish(String(data=rig.robot.urdf))
    rig.until(lambda: "another robot_description" not in rig.peer.reason)
    rig.peer.node.destroy_publisher(publisher)


def record_twice(rig: Rig) -> None:
    rig.answer = rig.peer.call(SetBool, "/ik_node/record", SetBool.Request(data=True), rig.tick).message


def hang(duration_s: float) -> Callable[[Rig], None]:
    """A cause: SIGSTOP, and SIGCONT after a time in which joint states and targets go on."""

    def cause(rig: Rig) -> None:
        pid = rig.peer.processes[-1].pid
        os.kill(pid, signal.SIGSTOP)
        rig.spin(duration_s)
        rig.mark()
        os.kill(pid, signal.SIGCONT)

    return cause


HELD_UP = Right(STOPPED, "the node was held up for", 0.05, at_once=True)
PAUSE = Right(PAUSED, "paused by request", 0.5, back=UNPAUSE)
SLOWED = "a velocity limit was lowered"

REQUEST_FAULTS = (
    Fault(
        "velocity limit lowered while tracking",
        setting(limits__velocity_fraction=0.02),
        Right(text=SLOWED),
        "F05",
        restore_limits,
    ),
    Fault(
        "velocity limits set to 1e-3 rad/s",
        setting(limits__velocity=[1e-3]),
        Right(text=SLOWED),
        "F05",
        setting(limits__velocity=[2.175]),
    ),
    Fault("velocity limit lowered in a ramp", pause_and_lower, PAUSE._replace(zero_s=2.5), "F05", restore_limits),
    Fault(
        "acceleration limit lowered in a ramp",
        pause_and_lower_acceleration,
        PAUSE._replace(zero_s=2.5),
        "F05",
        restore_limits,
    ),
    Fault(
        "acceleration limit lowered while tracking", setting(limits__acceleration=[0.4]), Right(), "", restore_limits
    ),
    Fault("position limit lowered below the position", outside_position_limits, Right(), "", no_position_limits),
    refused("obstacles__posture", (1.0, 2.0, 3.0), "obstacles.posture has 3 values; expected", "F08"),
    accepted("obstacles__posture", (0.5,), (), "F08"),
    refused("limits__velocity", (0.0,), "limits.velocity"),
    refused("limits__velocity", (-1.0,), "limits.velocity"),
    refused("limits__acceleration", (5.0, 5.0), "limits.acceleration has 2 values; expected 1 or 7"),
    refused("limits__acceleration", (float("nan"),), "limits.acceleration"),
    refused("limits__position_lower", (3.0,), "no range"),
    refused("gain", (-1.0, 10.0), "gain"),
    refused("gain", (float("inf"), 10.0), "gain"),
    refused("gain", (1.0, 2.0, 3.0), "gain"),
    refused("gain", "fast", "gain is 'fast' (string)", "W13"),
    refused("gian", 1.0, "unknown parameter 'gian'; nearest: gain", "W13"),
    refused("rate_hz", 500.0, "rate_hz"),
    refused("method", "best", "method is 'best'"),
    refused("state__timeout_s", 0, "state.timeout_s is 0.0; valid", "W13"),
    accepted("target__timeout_s", 2, 0.5, "W13"),
    accepted("gain", (200.0, 200.0), (10.0, 10.0)),
    accepted("control_law", "ik_difference", "twist_feedback"),
    Fault("pause while moving", pause, PAUSE),
    Fault("joint states end in the ramp of a pause", pause_and_silence, PAUSE._replace(zero_s=2.5), "", restore_limits),
    Fault("reset while moving", reset, Right()),
    Fault(
        "deactivated and activated while moving", transition(4), Right(PAUSED, "deactivated", 0.5), "", transition(3)
    ),
    Fault("record while recording", record_twice, Right(text="recording to")),
    Fault("no subscriber of the commands", no_subscriber, Right(STOPPED, "no subscriber", 0.5), "", subscribe_again),
    Fault("another commander on the same topic", other_commander, Right()),
    Fault("another description while moving", other_description, Right(text="another robot_description")),
    Fault("hang of 0.6 s (SIGSTOP, SIGCONT)", hang(0.6), HELD_UP, "F09"),
    Fault("hang of 2 s (SIGSTOP, SIGCONT)", hang(2.0), HELD_UP, "F09"),
)

"""Every way into the controller, as a recording knows it: a new kind of input is one line here.

Node, recording and replay share these tables: what an input is called, which message it is, how its bytes are
understood, and which method of the controller takes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ik_node.control.controller import Controller
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Step
from ik_node.messages.decode import decode_joint_state, decode_pose
from ik_node.messages.decode_obstacles import MARKERS_TYPE, decode_obstacles
from ik_node.messages.decode_targets import (
    PATH_TYPE,
    TRAJECTORY_TYPE,
    TWIST_TYPE,
    decode_path,
    decode_trajectory,
    decode_twist,
)
from ik_node.messages.step_codec import CallKind
from ik_node.settings.groups import Settings


class Input(NamedTuple):
    """A topic that the controller listens to."""

    name: str
    topic: str
    """As ROS resolves it for a node: ``~/`` is the node's own name."""
    type_name: str
    decode: Callable[[bytes], Any]
    """Message bytes -> what the call takes; InputError when they are no such message."""
    make: Callable[[Controller, Any, Instant], Step | None]
    """The call itself; an IkNodeError says what was refused."""
    streamed: bool = False
    """Only the newest counts: a lost one need not be sent again."""


JOINT_STATES = "joint_states"
TARGET_POSE = "target_pose"
OBSTACLES = "obstacles"

INPUTS: Mapping[CallKind, Input] = {
    CallKind.ON_JOINT_STATE: Input(
        JOINT_STATES, JOINT_STATES, "sensor_msgs/msg/JointState", decode_joint_state, Controller.on_joint_state, True
    ),
    CallKind.ON_TARGET_POSE: Input(
        TARGET_POSE, "~/target_pose", "geometry_msgs/msg/PoseStamped", decode_pose, Controller.on_target_pose, True
    ),
    CallKind.ON_TARGET_PATH: Input("target_path", "~/target_path", PATH_TYPE, decode_path, Controller.on_target_path),
    CallKind.ON_TARGET_TRAJECTORY: Input(
        "target_trajectory", "~/target_trajectory", TRAJECTORY_TYPE, decode_trajectory, Controller.on_target_trajectory
    ),
    CallKind.ON_TARGET_TWIST: Input(
        "target_twist", "~/target_twist", TWIST_TYPE, decode_twist, Controller.on_target_twist, True
    ),
    CallKind.ON_OBSTACLES: Input(OBSTACLES, "~/obstacles", MARKERS_TYPE, decode_obstacles, Controller.on_obstacles),
}
"""Calls that take a message."""

TEXT_CALLS: Mapping[CallKind, Callable[[Controller, str, Instant], Step | None]] = {
    CallKind.ON_LISTENERS: lambda controller, count, now: controller.on_listeners(int(count), now),
    CallKind.ON_PUBLISHERS: Controller.on_publishers,
    CallKind.ON_TRANSFORM: Controller.on_transform,
    CallKind.PAUSE: lambda controller, reason, now: controller.pause(now, reason),
}
"""Calls that take a text."""

SETTINGS_CALLS: Mapping[CallKind, Callable[[Controller, Settings, Instant], Step | None]] = {
    CallKind.APPLY: lambda controller, settings, now: controller.apply(settings),
}
"""Calls that take all settings."""

BARE_CALLS: Mapping[CallKind, Callable[[Controller, Instant], Step | None]] = {
    CallKind.ON_CLOCK: Controller.on_clock,
    CallKind.RESUME: lambda controller, now: controller.resume(),
    CallKind.RESET: lambda controller, now: controller.reset(),
}
"""Calls that take nothing but the time, if that."""

INPUT_TYPES: Mapping[str, str] = {entry.name: entry.type_name for entry in INPUTS.values()}
"""Input -> message type."""

"""Input topics of the controller: name, topic, message type and decoder.

The other half, which method of the controller takes a decoded message, is :mod:`ik_node.replay.call_table`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ik_node.messages.decode import decode_joint_state
from ik_node.messages.decode_obstacles import MARKERS_TYPE, decode_obstacles
from ik_node.messages.decode_targets import (
    PATH_TYPE,
    POSE_TYPE,
    TRAJECTORY_TYPE,
    TWIST_TYPE,
    decode_path,
    decode_pose,
    decode_trajectory,
    decode_twist,
)
from ik_node.messages.step_codec import CallKind


class Input(NamedTuple):
    """An input topic of the controller."""

    name: str
    topic: str
    """As ROS resolves it for a node: ``~/`` is the node's own name."""
    type_name: str
    decode: Callable[[bytes], Any]
    """CDR bytes -> argument of the call; raises InputError for other bytes."""
    streamed: bool = False
    """True when only the newest message matters, so that a lost one need not be sent again."""


JOINT_STATES = "joint_states"
TARGET_POSE = "target_pose"
OBSTACLES = "obstacles"

INPUTS: Mapping[CallKind, Input] = {
    CallKind.ON_JOINT_STATE: Input(
        JOINT_STATES, JOINT_STATES, "sensor_msgs/msg/JointState", decode_joint_state, streamed=True
    ),
    CallKind.ON_TARGET_POSE: Input(TARGET_POSE, "~/target_pose", POSE_TYPE, decode_pose, streamed=True),
    CallKind.ON_TARGET_PATH: Input("target_path", "~/target_path", PATH_TYPE, decode_path),
    CallKind.ON_TARGET_TRAJECTORY: Input(
        "target_trajectory", "~/target_trajectory", TRAJECTORY_TYPE, decode_trajectory
    ),
    CallKind.ON_TARGET_TWIST: Input("target_twist", "~/target_twist", TWIST_TYPE, decode_twist, streamed=True),
    CallKind.ON_OBSTACLES: Input(OBSTACLES, "~/obstacles", MARKERS_TYPE, decode_obstacles),
}
"""Calls that take a message."""

TEXT_CALLS = (
    CallKind.ON_LISTENERS,
    CallKind.ON_PUBLISHERS,
    CallKind.ON_TRANSFORM,
    CallKind.ON_INPUT_NOTE,
    CallKind.ON_METHOD_FAULT,
    CallKind.PAUSE,
)
"""Calls that take a text."""

INPUT_TYPES: Mapping[str, str] = {entry.name: entry.type_name for entry in INPUTS.values()}
"""Name of an input -> message type."""

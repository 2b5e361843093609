"""Plain data -> CDR bytes of single messages, and the table of output topics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.step import Status
from ik_node.math.types import Array
from ik_node.messages.cdr import Template, blank, header, make, serialize

COMMANDS = "commands"
JOINT_VELOCITY = "joint_velocity"
CURRENT_POSE = "current_pose"
DESIRED_POSE = "desired_pose"
TWIST_ERROR = "twist_error"
MULTIPLIER_TASK = "multiplier/task"
MULTIPLIER_POTENTIAL = "multiplier/potential"
STATUS = "status"
DIAGNOSTICS = "/diagnostics"

TYPES = {
    COMMANDS: "std_msgs/msg/Float64MultiArray",
    JOINT_VELOCITY: "sensor_msgs/msg/JointState",
    CURRENT_POSE: "geometry_msgs/msg/PoseStamped",
    DESIRED_POSE: "geometry_msgs/msg/PoseStamped",
    TWIST_ERROR: "geometry_msgs/msg/TwistStamped",
    MULTIPLIER_TASK: "geometry_msgs/msg/WrenchStamped",
    MULTIPLIER_POTENTIAL: "geometry_msgs/msg/WrenchStamped",
    STATUS: "diagnostic_msgs/msg/DiagnosticStatus",
    DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
}
"""Output topic -> message type; topics without a leading slash are relative to the name of the node."""


class Outgoing(NamedTuple):
    """A message to be published."""

    topic: str
    """A key of :data:`TYPES`."""
    data: bytes
    """CDR."""


# --- single messages ---


def encode_string(text: str) -> bytes:
    """Encodes a std_msgs/String."""
    return serialize(make("std_msgs/msg/String", data=text))


def encode_joint_state(
    names: tuple[str, ...],
    stamp_ns: int,
    position: Array | None = None,
    velocity: Array | None = None,
    frame_id: str = "",
) -> bytes:
    """Encodes a sensor_msgs/JointState.

    Args:
        names: Joints.
        stamp_ns: ROS time.
        position: (len(names),), rad (m); default: none.
        velocity: (len(names),), rad/s (m/s); default: none.
        frame_id: :data:`ik_node.messages.decode.SIMULATED_ARM` for a simulated arm; drivers leave it empty.

    Raises:
        InputError: An array has another shape or type.
    """
    given = [values for values in (position, velocity) if values is not None]
    template = joint_state_template(names, position is not None, velocity is not None, frame_id)
    return template.fill(stamp_ns, *[_bytes(values, len(names)) for values in given])


def encode_pose(frame_id: str, stamp_ns: int, position: Array, quaternion_xyzw: Array) -> bytes:
    """Encodes a geometry_msgs/PoseStamped of a position (3,), m, and a quaternion (4,), which are not validated."""
    return pose_template(frame_id).fill(stamp_ns, _bytes(position, 3) + _bytes(quaternion_xyzw, 4))


def encode_twist(frame_id: str, stamp_ns: int, twist: Array) -> bytes:
    """Encodes a geometry_msgs/TwistStamped of (v, omega), (6,), m/s and rad/s."""
    return twist_template(frame_id).fill(stamp_ns, _bytes(twist, 6))


def encode_wrench(frame_id: str, stamp_ns: int, wrench: Array) -> bytes:
    """Encodes a geometry_msgs/WrenchStamped of (force, torque), (6,), N and N m."""
    return wrench_template(frame_id).fill(stamp_ns, _bytes(wrench, 6))


def encode_command(joint_velocity: Array) -> bytes:
    """Encodes a command as the forwarding controllers of ros2_control expect it.

    Args:
        joint_velocity: (n,), rad/s (m/s).

    Returns:
        CDR bytes of a std_msgs/Float64MultiArray without a layout.

    Raises:
        InputError: A velocity is not finite; this is the last check before the motors.
    """
    if not np.isfinite(joint_velocity).all():
        raise InputError(f"command is not finite: {joint_velocity}")
    return command_template(len(joint_velocity)).fill(0, _bytes(joint_velocity, len(joint_velocity)))


def encode_status(status: Status, name: str, values: Mapping[str, str] | None = None, hardware_id: str = "") -> bytes:
    """Encodes a diagnostic_msgs/DiagnosticStatus: the reason is its message, the mode its first value."""
    return serialize(_status_message(status, name, values or {}, hardware_id))


def encode_diagnostics(statuses: Iterable[tuple[Status, str, Mapping[str, str]]], stamp_ns: int) -> bytes:
    """Encodes a diagnostic_msgs/DiagnosticArray of (status, name, values)."""
    messages = [_status_message(status, name, values, "") for status, name, values in statuses]
    return serialize(make("diagnostic_msgs/msg/DiagnosticArray", header=header("", stamp_ns), status=messages))


def _status_message(status: Status, name: str, values: Mapping[str, str], hardware_id: str) -> object:
    pairs = {"mode": status.mode.value, **values}
    return make(
        "diagnostic_msgs/msg/DiagnosticStatus",
        level=status.level.value,
        name=name,
        message=status.reason,
        hardware_id=hardware_id,
        values=[make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in pairs.items()],
    )


# --- templates ---


def _bytes(values: Array, size: int) -> bytes:
    if values.shape != (size,) or values.dtype != np.float64:
        raise InputError(f"array of {values.dtype} and shape {values.shape}, expected float64 and ({size},)")
    return values.tobytes()


@lru_cache(maxsize=64)
def joint_state_template(
    names: tuple[str, ...], with_position: bool, with_velocity: bool, frame_id: str = ""
) -> Template:
    """sensor_msgs/JointState of these names, with the given arrays."""
    n, none = len(names), np.empty(0)
    message = make(
        "sensor_msgs/msg/JointState",
        header=header(frame_id),
        name=list(names),
        position=blank(n) if with_position else none,
        velocity=blank(n) if with_velocity else none,
        effort=none,
    )
    return Template(message, (n,) * (with_position + with_velocity), stamped=True)


@lru_cache(maxsize=64)
def pose_template(frame_id: str) -> Template:
    """geometry_msgs/PoseStamped in a frame."""
    x = float(blank(1)[0])
    pose = make("geometry_msgs/msg/Pose", position=_triple("Point", x), orientation=_quaternion(x))
    return Template(make("geometry_msgs/msg/PoseStamped", header=header(frame_id), pose=pose), (7,), stamped=True)


@lru_cache(maxsize=64)
def twist_template(frame_id: str) -> Template:
    """geometry_msgs/TwistStamped in a frame."""
    x = float(blank(1)[0])
    twist = make("geometry_msgs/msg/Twist", linear=_triple("Vector3", x), angular=_triple("Vector3", x))
    return Template(make("geometry_msgs/msg/TwistStamped", header=header(frame_id), twist=twist), (6,), stamped=True)


@lru_cache(maxsize=64)
def wrench_template(frame_id: str) -> Template:
    """geometry_msgs/WrenchStamped in a frame."""
    x = float(blank(1)[0])
    wrench = make("geometry_msgs/msg/Wrench", force=_triple("Vector3", x), torque=_triple("Vector3", x))
    return Template(make("geometry_msgs/msg/WrenchStamped", header=header(frame_id), wrench=wrench), (6,), stamped=True)


@lru_cache(maxsize=64)
def command_template(n: int) -> Template:
    """std_msgs/Float64MultiArray of n numbers without a layout."""
    layout = make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return Template(make("std_msgs/msg/Float64MultiArray", layout=layout, data=blank(n)), (n,), stamped=False)


def _triple(kind: str, value: float) -> object:
    return make(f"geometry_msgs/msg/{kind}", x=value, y=value, z=value)


def _quaternion(value: float) -> object:
    return make("geometry_msgs/msg/Quaternion", x=value, y=value, z=value, w=value)

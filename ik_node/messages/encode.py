"""Plain data -> message bytes: what the simulator and the demonstration send, and what the node says of a Step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.step import Level, Mode, Status, Step
from ik_node.math import se3
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
"""Output topic -> message type. Topics without a leading slash live under the node's own name."""


class Outgoing(NamedTuple):
    """One message to publish."""

    topic: str
    """A key of :data:`TYPES`."""
    data: bytes
    """CDR."""


# --- single messages ---


def encode_string(text: str) -> bytes:
    """std_msgs/String."""
    return serialize(make("std_msgs/msg/String", data=text))


def encode_joint_state(
    names: tuple[str, ...], stamp_ns: int, position: Array | None = None, velocity: Array | None = None
) -> bytes:
    """sensor_msgs/JointState of ``position`` [rad, m] and ``velocity`` [rad/s, m/s], each (len(names),) or left out."""
    given = [values for values in (position, velocity) if values is not None]
    template = _joint_state_template(names, position is not None, velocity is not None)
    return template.fill(stamp_ns, *[_bytes(values, len(names)) for values in given])


def encode_pose(frame_id: str, stamp_ns: int, position: Array, quaternion_xyzw: Array) -> bytes:
    """geometry_msgs/PoseStamped of a position (3,) [m] and a quaternion (4,), not checked."""
    return _pose_template(frame_id).fill(stamp_ns, _bytes(position, 3) + _bytes(quaternion_xyzw, 4))


def encode_twist(frame_id: str, stamp_ns: int, twist: Array) -> bytes:
    """geometry_msgs/TwistStamped of (v, omega), (6,) [m/s, rad/s]."""
    return _twist_template(frame_id).fill(stamp_ns, _bytes(twist, 6))


def encode_wrench(frame_id: str, stamp_ns: int, wrench: Array) -> bytes:
    """geometry_msgs/WrenchStamped of (force, torque), (6,) [N, N m]."""
    return _wrench_template(frame_id).fill(stamp_ns, _bytes(wrench, 6))


def encode_command(joint_velocity: Array) -> bytes:
    """std_msgs/Float64MultiArray of joint velocities (n,), without a layout, as ros2_control's forwarding
    controllers take it.

    Raises InputError when one of them is not finite: this is the last gate before the motors.
    """
    if not np.isfinite(joint_velocity).all():
        raise InputError(f"command is not finite: {joint_velocity}")
    return _command_template(len(joint_velocity)).fill(0, _bytes(joint_velocity, len(joint_velocity)))


def encode_status(status: Status, name: str, values: Mapping[str, str] | None = None, hardware_id: str = "") -> bytes:
    """diagnostic_msgs/DiagnosticStatus: the reason as its message, the mode as the first of its values."""
    return serialize(_status_message(status, name, values or {}, hardware_id))


def encode_diagnostics(statuses: Iterable[tuple[Status, str, Mapping[str, str]]], stamp_ns: int) -> bytes:
    """diagnostic_msgs/DiagnosticArray of (status, name, values)."""
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


# --- a Step ---


class StepOutputs:
    """Says a Step on the node's output topics; one instance per node."""

    def __init__(self, joints: tuple[str, ...], base_frame: str, tip_frame: str) -> None:
        """Makes every template now: the first tick must not take ten milliseconds longer than the rest."""
        self.joints = joints
        self.base_frame = base_frame
        self.tip_frame = tip_frame
        _command_template(len(joints))
        _joint_state_template(joints, False, True)
        _pose_template(base_frame)
        _twist_template(tip_frame)
        _wrench_template(tip_frame)
        encode_diagnostics([(Status(Level.OK, Mode.WAITING, ""), "", {})], 0)

    def command(self, step: Step) -> bytes:
        """The message for :data:`COMMANDS`: apart from the rest because it must leave first."""
        return encode_command(step.joint_velocity)

    def others(self, step: Step) -> list[Outgoing]:
        """The messages for the remaining topics of every tick, stamped with the tick's ROS time.

        What a stopped tick did not compute (NaN) is left out.
        """
        stamp_ns = step.now.ros_ns
        messages = [Outgoing(JOINT_VELOCITY, encode_joint_state(self.joints, stamp_ns, velocity=step.joint_velocity))]
        for topic, pose in ((CURRENT_POSE, step.pose_sb), (DESIRED_POSE, step.pose_sd)):
            if np.isfinite(pose).all():
                quaternion = se3.quaternion_from_rotation(pose[:3, :3])
                messages.append(Outgoing(topic, encode_pose(self.base_frame, stamp_ns, pose[:3, 3], quaternion)))
        if np.isfinite(step.error_b).all():
            messages.append(Outgoing(TWIST_ERROR, encode_twist(self.tip_frame, stamp_ns, step.error_b)))
        for topic, term in (
            (MULTIPLIER_TASK, step.multiplier_task),
            (MULTIPLIER_POTENTIAL, step.multiplier_potential),
        ):
            if np.isfinite(term).all():
                messages.append(Outgoing(topic, encode_wrench(self.tip_frame, stamp_ns, term)))
        return messages


def step_values(step: Step, method: str) -> dict[str, str]:
    """What status and diagnostics say of a tick besides mode and reason, as text with units in the keys."""
    return {
        "method": method,
        "scale": f"{step.scale:.6g}",
        "sigma_min_m": f"{step.singular_values[-1]:.6g}",
        "position_error_mm": f"{1e3 * _norm(step.error_b[:3]):.6g}",
        "orientation_error_mrad": f"{1e3 * _norm(step.error_b[3:]):.6g}",
        "lost_linear_m_s": f"{_norm(step.lost_b[:3]):.6g}",
        "lost_angular_rad_s": f"{_norm(step.lost_b[3:]):.6g}",
        "progress": f"{step.progress:.6g}",
        "path_distance_m": f"{step.path_distance:.6g}",
        "clearance_m": f"{step.clearance:.6g}",
        "closest_pair": " - ".join(step.closest_pair),
        "binding": ", ".join(step.binding),
    }


def _norm(vector: Array) -> float:
    return float(np.sqrt(vector @ vector))


# --- templates ---


def _bytes(values: Array, size: int) -> bytes:
    if values.shape != (size,) or values.dtype != np.float64:
        raise InputError(f"array of {values.dtype} and shape {values.shape}, expected float64 and ({size},)")
    return values.tobytes()


@lru_cache(maxsize=64)
def _joint_state_template(names: tuple[str, ...], with_position: bool, with_velocity: bool) -> Template:
    n, none = len(names), np.empty(0)
    message = make(
        "sensor_msgs/msg/JointState",
        header=header(""),
        name=list(names),
        position=blank(n) if with_position else none,
        velocity=blank(n) if with_velocity else none,
        effort=none,
    )
    return Template(message, (n,) * (with_position + with_velocity), stamped=True)


@lru_cache(maxsize=64)
def _pose_template(frame_id: str) -> Template:
    x = float(blank(1)[0])
    pose = make("geometry_msgs/msg/Pose", position=_triple("Point", x), orientation=_quaternion(x))
    return Template(make("geometry_msgs/msg/PoseStamped", header=header(frame_id), pose=pose), (7,), stamped=True)


@lru_cache(maxsize=64)
def _twist_template(frame_id: str) -> Template:
    x = float(blank(1)[0])
    twist = make("geometry_msgs/msg/Twist", linear=_triple("Vector3", x), angular=_triple("Vector3", x))
    return Template(make("geometry_msgs/msg/TwistStamped", header=header(frame_id), twist=twist), (6,), stamped=True)


@lru_cache(maxsize=64)
def _wrench_template(frame_id: str) -> Template:
    x = float(blank(1)[0])
    wrench = make("geometry_msgs/msg/Wrench", force=_triple("Vector3", x), torque=_triple("Vector3", x))
    return Template(make("geometry_msgs/msg/WrenchStamped", header=header(frame_id), wrench=wrench), (6,), stamped=True)


@lru_cache(maxsize=64)
def _command_template(n: int) -> Template:
    layout = make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    return Template(make("std_msgs/msg/Float64MultiArray", layout=layout, data=blank(n)), (n,), stamped=False)


def _triple(kind: str, value: float) -> object:
    return make(f"geometry_msgs/msg/{kind}", x=value, y=value, z=value)


def _quaternion(value: float) -> object:
    return make("geometry_msgs/msg/Quaternion", x=value, y=value, z=value, w=value)

"""The messages that the node publishes for each Step.

Not imported by the reading side of a recording: quaternions come from compiled code, which loads numba.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ik_node.interfaces.step import Level, Mode, Status, Step, smallest_singular_value
from ik_node.interfaces.twist_account import twist_account
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.messages.encode import (
    COMMANDS,
    CURRENT_POSE,
    DESIRED_POSE,
    JOINT_VELOCITY,
    MULTIPLIER_POTENTIAL,
    MULTIPLIER_TASK,
    TWIST_ERROR,
    Outgoing,
    command_template,
    encode_command,
    encode_diagnostics,
    encode_joint_state,
    encode_pose,
    encode_twist,
    encode_wrench,
    joint_state_template,
    pose_template,
    twist_template,
    wrench_template,
)

STEP_TOPICS = (JOINT_VELOCITY, CURRENT_POSE, DESIRED_POSE, TWIST_ERROR, MULTIPLIER_TASK, MULTIPLIER_POTENTIAL)
"""Topics of a Step other than the command."""


class StepOutputs:
    """Encodes Steps for the node's output topics; one instance per node."""

    def __init__(self, joints: tuple[str, ...], base_frame: str, tip_frame: str) -> None:
        """Creates all templates now, which saves 10 ms in the first control step."""
        self.joints = joints
        self.base_frame = base_frame
        self.tip_frame = tip_frame
        command_template(len(joints))
        joint_state_template(joints, False, True)
        pose_template(base_frame)
        twist_template(tip_frame)
        wrench_template(tip_frame)
        encode_diagnostics([(Status(Level.OK, Mode.WAITING, ""), "", {})], 0)

    def command(self, step: Step) -> bytes:
        """The message of :data:`COMMANDS`, separate from the others because it is published first."""
        return encode_command(step.joint_velocity)

    def messages(self, step: Step) -> list[Outgoing]:
        """All messages of a Step, the command first."""
        return [Outgoing(COMMANDS, self.command(step)), *self.others(step)]

    def others(self, step: Step, topics: Collection[str] = STEP_TOPICS) -> list[Outgoing]:
        """The messages on those of ``topics`` that are in :data:`STEP_TOPICS`, stamped with the ROS time of the Step.

        Poses, errors and multipliers that contain NaN are left out.
        """
        stamp_ns, messages = step.now.ros_ns, []
        if JOINT_VELOCITY in topics:
            velocity = encode_joint_state(self.joints, stamp_ns, velocity=step.joint_velocity)
            messages.append(Outgoing(JOINT_VELOCITY, velocity))
        for topic, pose in ((CURRENT_POSE, step.pose_sb), (DESIRED_POSE, step.pose_sd)):
            if topic in topics and np.isfinite(pose).all():
                quaternion = quaternion_from_rotation(pose[:3, :3])
                messages.append(Outgoing(topic, encode_pose(self.base_frame, stamp_ns, pose[:3, 3], quaternion)))
        if TWIST_ERROR in topics and np.isfinite(step.error_b).all():
            messages.append(Outgoing(TWIST_ERROR, encode_twist(self.tip_frame, stamp_ns, step.error_b)))
        for topic, term in (
            (MULTIPLIER_TASK, step.multiplier_task),
            (MULTIPLIER_POTENTIAL, step.multiplier_potential),
        ):
            if topic in topics and np.isfinite(term).all():
                messages.append(Outgoing(topic, encode_wrench(self.tip_frame, stamp_ns, term)))
        return messages


def step_values(step: Step, method: str) -> dict[str, str]:
    """Key-value pairs of status and diagnostics: results of the Step as text, units in the keys."""
    account = twist_account(step.twist_b, step.truncated_b, step.off_direction_b, step.scale)
    return {
        "method": method,
        "scale": f"{step.scale:.6g}",
        "sigma_min_m": f"{float(smallest_singular_value(step.singular_values)):.6g}",
        "position_error_mm": f"{1e3 * _norm(step.error_b[:3]):.6g}",
        "orientation_error_mrad": f"{1e3 * _norm(step.error_b[3:]):.6g}",
        "truncated_linear_m_s": f"{_norm(step.truncated_b[:3]):.6g}",
        "truncated_angular_rad_s": f"{_norm(step.truncated_b[3:]):.6g}",
        "held_back_linear_m_s": f"{_norm(account.held_back[:3]):.6g}",
        "held_back_angular_rad_s": f"{_norm(account.held_back[3:]):.6g}",
        "off_direction_linear_m_s": f"{_norm(step.off_direction_b[:3]):.6g}",
        "off_direction_angular_rad_s": f"{_norm(step.off_direction_b[3:]):.6g}",
        "off_direction_limits": ", ".join(step.off_direction_limits),
        "progress": f"{step.progress:.6g}",
        "path_distance_m": f"{step.path_distance:.6g}",
        "clearance_m": f"{step.clearance:.6g}",
        "closest_pair": " - ".join(step.closest_pair),
        "binding": ", ".join(step.binding),
    }


def _norm(vector: Array) -> float:
    return float(np.sqrt(vector @ vector))

"""Message bytes <-> plain data, the one conversion that live node, recording, replay and tests share.

The node subscribes and publishes raw CDR bytes; nothing here imports rclpy or a ROS message package. Encoding is
deterministic: the same content gives the same bytes.
"""

from ik_node.messages.decode import decode_command, decode_joint_state, decode_pose, decode_string
from ik_node.messages.encode import (
    COMMANDS,
    CURRENT_POSE,
    DESIRED_POSE,
    DIAGNOSTICS,
    JOINT_VELOCITY,
    MULTIPLIER_POTENTIAL,
    MULTIPLIER_TASK,
    STATUS,
    TWIST_ERROR,
    TYPES,
    Outgoing,
    StepOutputs,
    encode_command,
    encode_diagnostics,
    encode_joint_state,
    encode_pose,
    encode_status,
    encode_string,
    encode_twist,
    encode_wrench,
    step_values,
)
from ik_node.messages.step_codec import (
    Call,
    CallKind,
    StepDecoder,
    StepEncoder,
    StepMessages,
    decode_call,
    encode_call,
)

__all__ = [
    "COMMANDS",
    "CURRENT_POSE",
    "DESIRED_POSE",
    "DIAGNOSTICS",
    "JOINT_VELOCITY",
    "MULTIPLIER_POTENTIAL",
    "MULTIPLIER_TASK",
    "STATUS",
    "TWIST_ERROR",
    "TYPES",
    "Call",
    "CallKind",
    "Outgoing",
    "StepDecoder",
    "StepEncoder",
    "StepMessages",
    "StepOutputs",
    "decode_call",
    "decode_command",
    "decode_joint_state",
    "decode_pose",
    "decode_string",
    "encode_call",
    "encode_command",
    "encode_diagnostics",
    "encode_joint_state",
    "encode_pose",
    "encode_status",
    "encode_string",
    "encode_twist",
    "encode_wrench",
    "step_values",
]

"""Joint states, texts and commands: CDR bytes -> plain data. Values are not validated; the controller does that."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

from ik_node.errors import InputError
from ik_node.interfaces.samples import JointSample
from ik_node.math.types import Array
from ik_node.messages.cdr import LITTLE_ENDIAN, deserialize, floats_at, reading, stamp_at


class _Head(NamedTuple):
    """The bytes between stamp and positions of a JointState, which are equal in all messages of a driver."""

    data: bytes
    """Frame, names and number of positions."""
    names: tuple[str, ...]
    size: int
    begin: int
    """Offset of the positions."""


COMMAND_TYPE = "std_msgs/msg/Float64MultiArray"
STATE_TYPE = "sensor_msgs/msg/JointState"
SIMULATED_ARM = "simulated_arm"
"""``header.frame_id`` of the joint states of a simulated arm, so that a recording says what moved."""
MAX_JOINTS = 256
"""Names or positions of one message: a humanoid with two hands has about 80 joints."""
MAX_STATE_BYTES = 65_536
"""Size of a joint state: 256 joints with names of 200 bytes, positions, velocities and efforts."""
MAX_DESCRIPTION_BYTES = 8_000_000
"""Size of a robot description: the characters that are accepted (:data:`ik_node.robot.description.MAX_CHARACTERS`) with
4 bytes each. More is not decoded."""
MAX_COMMAND_BYTES = 4_096
"""Size of a command: 256 numbers and a layout."""
_HEAD_BEGIN = 12
_MAX_HEADS = 64
_heads: dict[int, _Head] = {}  # message length -> last head; a cache that does not affect the result


def decode_joint_state(data: bytes) -> JointSample:
    """Decodes a joint state.

    Args:
        data: CDR bytes of a sensor_msgs/JointState; velocities and efforts are ignored.

    Raises:
        InputError: The bytes are no such message, or it has more than :data:`MAX_JOINTS` names or positions.
    """
    head = _heads.get(len(data))
    if head is not None and data[:2] == LITTLE_ENDIAN and data.startswith(head.data, _HEAD_BEGIN):
        return JointSample(stamp_at(data), head.names, floats_at(data, head.size, head.begin))
    with reading(data, STATE_TYPE) as cursor:
        stamp_ns = cursor.stamp()
        cursor.string()
        count = cursor.bounded_count(MAX_JOINTS, "joint names")
        cursor.check_size(MAX_STATE_BYTES)
        names = tuple(cursor.string() for _ in range(count))
        size = cursor.bounded_count(MAX_JOINTS, "joint positions")
        begin = data[_HEAD_BEGIN : cursor.offset]
        sample = JointSample(stamp_ns, names, cursor.floats(size))
        if size and data[:2] == LITTLE_ENDIAN:
            if len(_heads) >= _MAX_HEADS:
                _heads.clear()
            _heads[len(data)] = _Head(begin, names, size, cursor.offset - 8 * size)
        return sample


def is_simulated(data: bytes) -> bool:
    """Whether bytes are a sensor_msgs/JointState of a simulated arm."""
    with suppress(InputError), reading(data, STATE_TYPE) as cursor:
        cursor.stamp()
        return cursor.string() == SIMULATED_ARM
    return False


def decode_string(data: bytes) -> str:
    """The text of a std_msgs/String; raises InputError for other bytes."""
    return str(deserialize(data, "std_msgs/msg/String").data)


def decode_description(data: bytes) -> str:
    """The text of a std_msgs/String; raises InputError for other bytes and for long messages."""
    if len(data) > MAX_DESCRIPTION_BYTES:
        raise InputError(f"{len(data)} bytes; at most {MAX_DESCRIPTION_BYTES} are accepted")
    return decode_string(data)


def decode_command(data: bytes) -> Array:
    """The flat numbers of a std_msgs/Float64MultiArray; raises InputError for other bytes and for long messages."""
    with reading(data, COMMAND_TYPE) as cursor:
        cursor.check_size(MAX_COMMAND_BYTES)
        for _ in range(cursor.count()):  # dimensions of the layout, which are rare
            cursor.string()
            cursor.skip(4, 4, 2)
        cursor.count()  # data_offset
        return cursor.floats(cursor.bounded_count(MAX_JOINTS, "numbers"))

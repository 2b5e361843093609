"""Joint states, texts and commands: CDR bytes -> plain data. Values are not validated; the controller does that."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.samples import JointSample
from ik_node.math.types import Array
from ik_node.messages.cdr import LITTLE_ENDIAN, Cursor, deserialize, floats_at, stamp_at, stamp_of


class _Head(NamedTuple):
    """The bytes between stamp and positions of a JointState, which are equal in all messages of a driver."""

    data: bytes
    """Frame, names and number of positions."""
    names: tuple[str, ...]
    size: int
    begin: int
    """Offset of the positions."""


COMMAND_TYPE = "std_msgs/msg/Float64MultiArray"
_HEAD_BEGIN = 12
_MAX_HEADS = 64
_heads: dict[int, _Head] = {}  # message length -> last head; a cache that does not affect the result


def decode_joint_state(data: bytes) -> JointSample:
    """Decodes a joint state.

    Args:
        data: CDR bytes of a sensor_msgs/JointState; velocities and efforts are ignored.

    Raises:
        InputError: The bytes are no such message.
    """
    if data[:2] != LITTLE_ENDIAN:
        message = deserialize(data, "sensor_msgs/msg/JointState")
        return JointSample(stamp_of(message), tuple(message.name), np.array(message.position, dtype=np.float64))
    head = _heads.get(len(data))
    if head is not None and data.startswith(head.data, _HEAD_BEGIN):
        return JointSample(stamp_at(data), head.names, floats_at(data, head.size, head.begin))
    try:
        return _read_joint_state(data)
    except (struct.error, ValueError) as error:
        raise InputError(f"bytes are no sensor_msgs/msg/JointState: {error}") from error


def _read_joint_state(data: bytes) -> JointSample:
    cursor = Cursor(data)
    stamp_ns = cursor.stamp()
    cursor.string()
    names = tuple(cursor.string() for _ in range(cursor.count()))
    size = cursor.count()
    head = data[_HEAD_BEGIN : cursor.offset]
    sample = JointSample(stamp_ns, names, cursor.floats(size))
    if size:
        if len(_heads) >= _MAX_HEADS:
            _heads.clear()
        _heads[len(data)] = _Head(head, names, size, cursor.offset - 8 * size)
    return sample


def decode_string(data: bytes) -> str:
    """The text of a std_msgs/String; raises InputError for other bytes."""
    return str(deserialize(data, "std_msgs/msg/String").data)


def decode_command(data: bytes) -> Array:
    """The flat numbers of a std_msgs/Float64MultiArray; raises InputError for other bytes."""
    if data[:2] != LITTLE_ENDIAN:
        return np.array(deserialize(data, COMMAND_TYPE).data, dtype=np.float64)
    try:
        cursor = Cursor(data)
        if cursor.count():  # with a layout, which is rare: general deserialiser
            return np.array(deserialize(data, COMMAND_TYPE).data, dtype=np.float64)
        cursor.count()  # data_offset, unused without a layout
        return cursor.floats(cursor.count())
    except (struct.error, ValueError) as error:
        raise InputError(f"bytes are no {COMMAND_TYPE}: {error}") from error

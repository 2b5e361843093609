"""CDR bytes of ROS 2 messages without ROS: the typestore of `rosbags`, and templates for messages of a fixed layout.

Messages that the node publishes in every control step differ only in stamp and numbers. The typestore serialises such a
message once; :class:`Template` then inserts new numbers, about ten times faster and with the same bytes (a test
compares both with the serialiser of ROS).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array

STORE = get_typestore(Stores.ROS2_JAZZY)
"""Every message type of ROS 2 Jazzy's common interfaces."""

LITTLE_ENDIAN = b"\x00\x01"
"""First two bytes of a plain CDR message with little-endian numbers."""
_STAMP_OFFSET = 4  # stamped messages start with a Header, and a Header starts with its stamp
_STAMP_END = 12
_SENTINEL = 1.0e-300 / 3.0  # a number that occurs nowhere else in a template
_stamp = struct.Struct("<iI")
_DOUBLE = np.dtype("<f8")


def make(type_name: str, **fields: Any) -> Any:
    """A message of ``type_name``, for example ``std_msgs/msg/String``; every field must be given."""
    return STORE.types[type_name](**fields)


def time_message(time_ns: int) -> Any:
    """A time in ns as builtin_interfaces/Time."""
    seconds, nanoseconds = divmod(time_ns, NS)
    return make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def header(frame_id: str, stamp_ns: int = 0) -> Any:
    """std_msgs/Header."""
    return make("std_msgs/msg/Header", stamp=time_message(stamp_ns), frame_id=frame_id)


def stamp_of(message: Any) -> int:
    """Stamp of ``message.header`` in ns."""
    return int(message.header.stamp.sec) * NS + int(message.header.stamp.nanosec)


def serialize(message: Any) -> bytes:
    """CDR bytes of any message of the typestore; deterministic, without trailing bytes."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))


def deserialize(data: bytes, type_name: str) -> Any:
    """The message in ``data``; raises InputError when the bytes are no ``type_name``."""
    try:
        return STORE.deserialize_cdr(data, type_name)
    except (SerdeError, struct.error, ValueError, IndexError) as error:
        raise InputError(f"bytes are no {type_name}: {error}") from error


class Template:
    """A serialised message of which only the stamp and blocks of float64 change."""

    def __init__(self, message: Any, block_sizes: tuple[int, ...], stamped: bool) -> None:
        """``message`` contains :func:`blank` arrays of ``block_sizes`` in serialisation order."""
        data = serialize(message)
        self.stamped = stamped
        self.parts: list[bytes] = []
        begin = _STAMP_END if stamped else 0
        for size in block_sizes:
            place = data.index(blank(size).tobytes(), begin)
            self.parts.append(data[begin:place])
            begin = place + 8 * size
        self.tail = data[begin:]
        self._lead = data[:_STAMP_OFFSET]

    def fill(self, stamp_ns: int, *blocks: bytes) -> bytes:
        """The message with new values.

        Args:
            stamp_ns: ROS time; ignored for messages without a stamp.
            blocks: Bytes of float64, one block per entry of ``block_sizes``.
        """
        pieces = [self._lead, _stamp.pack(*divmod(stamp_ns, NS))] if self.stamped else []
        for part, block in zip(self.parts, blocks, strict=True):
            pieces.append(part)
            pieces.append(block)
        pieces.append(self.tail)
        return b"".join(pieces)


def blank(size: int) -> Array:
    """Placeholder numbers that a :class:`Template` replaces."""
    return np.full(size, _SENTINEL)


def stamp_at(data: bytes, offset: int = _STAMP_OFFSET) -> int:
    """The builtin_interfaces/Time at ``offset`` in ns, by default that of the Header; struct.error beyond the end."""
    seconds: int
    nanoseconds: int
    seconds, nanoseconds = _stamp.unpack_from(data, offset)
    return seconds * NS + nanoseconds


def floats_at(data: bytes, size: int, offset: int) -> Array:
    """A new array of ``size`` > 0 float64 numbers at ``offset``; ValueError beyond the end."""
    return np.frombuffer(data, _DOUBLE, size, offset).astype(np.float64)


class Cursor:
    """Reads the fields of a little-endian CDR message in order; struct.error or ValueError beyond its end."""

    def __init__(self, data: bytes, offset: int = _STAMP_OFFSET) -> None:
        self.data = data
        self.offset = offset

    def stamp(self) -> int:
        """builtin_interfaces/Time as ns."""
        stamp_ns = stamp_at(self.data, self.offset)
        self.offset += 8
        return stamp_ns

    def count(self) -> int:
        """The length of a sequence or string."""
        self.offset += -self.offset % 4
        (value,) = struct.unpack_from("<I", self.data, self.offset)
        self.offset += 4
        return int(value)

    def string(self) -> str:
        """A string without its terminating zero."""
        length = self.count()
        end = self.offset + length
        if end > len(self.data):
            raise ValueError("a string exceeds the message")
        text = self.data[self.offset : end - 1].decode()
        self.offset = end
        return text

    def floats(self, size: int) -> Array:
        """A new array of ``size`` float64 numbers."""
        if size == 0:
            return np.empty(0)
        self.offset += (4 - self.offset) % 8  # 8-byte alignment relative to the end of the 4-byte encapsulation header
        values = floats_at(self.data, size, self.offset)
        self.offset += 8 * size
        return values

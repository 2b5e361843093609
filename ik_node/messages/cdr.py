"""CDR bytes of ROS 2 messages without ROS: the typestore of `rosbags`, and templates for messages of a fixed layout.

Messages that the node publishes in every control step differ only in stamp and numbers. The typestore serialises such a
message once; :class:`Template` then inserts new numbers, about ten times faster and with the same bytes (a test
compares both with the serialiser of ROS).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.math.types import Array

STORE = get_typestore(Stores.ROS2_JAZZY)
"""Every message type of ROS 2 Jazzy's common interfaces."""

LITTLE_ENDIAN = b"\x00\x01"
"""First two bytes of a plain CDR message with little-endian numbers."""
BIG_ENDIAN = b"\x00\x00"
"""The same with big-endian numbers."""
_ORDERS = {
    LITTLE_ENDIAN: (struct.Struct("<I"), struct.Struct("<iI"), np.dtype("<f8"), "<"),
    BIG_ENDIAN: (struct.Struct(">I"), struct.Struct(">iI"), np.dtype(">f8"), ">"),
}
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
    """CDR bytes of any message of the typestore; deterministic, without trailing bytes.

    Raises InputError when a number does not fit its field, for example a time of more than 68 years.
    """
    try:
        return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=True))
    except struct.error as error:
        raise InputError(f"a number does not fit into a {message.__msgtype__}: {error}") from error


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
    """Reads the fields of a CDR message of either byte order in their sequence.

    Reading beyond the end raises struct.error or ValueError; :func:`reading` turns both into InputError.
    """

    def __init__(self, data: bytes, offset: int = _STAMP_OFFSET) -> None:
        self.data = data
        self.offset = offset
        if data[:2] not in (LITTLE_ENDIAN, BIG_ENDIAN):
            raise ValueError("the first two bytes are not those of plain CDR")
        self._count, self._time, self._double, self._order = _ORDERS[data[:2]]

    def stamp(self) -> int:
        """builtin_interfaces/Time or Duration as ns."""
        self.offset += -self.offset % 4
        seconds, nanoseconds = self._time.unpack_from(self.data, self.offset)
        self.offset += 8
        return int(seconds) * NS + int(nanoseconds)

    def count(self) -> int:
        """The length of a sequence or string, or another unsigned number of 32 bits."""
        self.offset += -self.offset % 4
        (value,) = self._count.unpack_from(self.data, self.offset)
        self.offset += 4
        return int(value)

    def bounded_count(self, limit: int, what: str) -> int:
        """:meth:`count` of a sequence of ``what``; raises InputError above ``limit``, before the sequence is read."""
        if (value := self.count()) > limit:
            raise InputError(f"{value} {what}; at most {limit} are accepted")
        return value

    def check_size(self, limit: int) -> None:
        """Raises InputError when the whole message is longer than ``limit`` bytes."""
        if len(self.data) > limit:
            raise InputError(f"a message of {len(self.data)} bytes; at most {limit} are accepted")

    def string(self) -> str:
        """A string without its terminating zero."""
        length = self.count()
        end = self.offset + length
        if end > len(self.data):
            raise ValueError("a string exceeds the message")
        text = self.data[self.offset : end - 1].decode()
        self.offset = end
        return text

    def skip(self, size: int, alignment: int, count: int = 1) -> None:
        """Passes ``count`` fields of ``size`` bytes without reading them."""
        if count:
            self.offset += (4 - self.offset) % alignment + size * count
        if self.offset > len(self.data):
            raise ValueError("a sequence exceeds the message")

    def records(self, counts: Sequence[int], count: int) -> NDArray[Any]:
        """Records of the same layout: for each of ``counts`` a sequence of that many float64, then a Time.

        Args:
            counts: Numbers per sequence; they determine the layout.
            count: Number of records. The padding of the first one in a message may differ from that of the next ones.

        Returns:
            Structured array of at most ``count`` records, as many as the message has bytes for: ``length_i`` and
            ``numbers_i`` of sequence i, ``seconds``, ``nanoseconds``. The first length that does not belong to
            ``counts`` means that what follows it has another layout.
        """
        self.offset += -self.offset % 4
        fields: list[tuple[Any, ...]] = []
        place = self.offset - 4
        for index, size in enumerate(counts):
            fields.append((f"length_{index}", f"{self._order}u4"))
            place += 4
            if size:
                if place % 8:
                    fields.append((f"padding_{index}", "V4"))
                fields.append((f"numbers_{index}", self._double, size))
                place += place % 8 + 8 * size
        layout = np.dtype([*fields, ("seconds", f"{self._order}i4"), ("nanoseconds", f"{self._order}u4")])
        complete = max(len(self.data) - self.offset, 0) // layout.itemsize
        records = np.frombuffer(self.data, layout, min(count, complete), self.offset)
        self.offset += records.nbytes
        return records

    def floats(self, size: int) -> Array:
        """A new array of ``size`` float64 numbers."""
        if size == 0:
            return np.empty(0)
        self.offset += (4 - self.offset) % 8  # 8-byte alignment relative to the end of the 4-byte encapsulation header
        values = np.frombuffer(self.data, self._double, size, self.offset).astype(np.float64)
        self.offset += 8 * size
        return values


@contextmanager
def reading(data: bytes, type_name: str) -> Iterator[Cursor]:
    """A cursor behind the encapsulation header of a message.

    Raises:
        InputError: Reading raised struct.error or ValueError; names the type.
    """
    try:
        yield Cursor(data)
    except InputError:
        raise
    except (struct.error, ValueError) as error:
        raise InputError(f"bytes are no {type_name}: {error}") from error

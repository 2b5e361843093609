"""Header stamps of messages moved to another time."""

from __future__ import annotations

import dataclasses
from typing import Any

from ik_node.interfaces.clock import NS
from ik_node.messages.cdr import deserialize, serialize, time_message

_HEADER = "std_msgs/msg/Header"


def restamped(data: bytes, type_name: str, later_ns: int) -> bytes:
    """The message with every header stamp ``later_ns`` later; 0, which means "now", stays.

    InputError when the bytes are no ``type_name``.
    """
    message = deserialize(data, type_name)
    _move(message, later_ns)
    return serialize(message)


def _move(message: Any, later_ns: int) -> None:
    if message.__msgtype__ == _HEADER:
        stamp_ns = int(message.stamp.sec) * NS + int(message.stamp.nanosec)
        if stamp_ns:
            message.stamp = time_message(stamp_ns + later_ns)
        return
    for entry in dataclasses.fields(message):
        value = getattr(message, entry.name)
        for part in value if isinstance(value, list) else (value,):
            if hasattr(part, "__msgtype__"):
                _move(part, later_ns)

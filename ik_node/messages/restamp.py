"""Messages with shifted header stamps."""

from __future__ import annotations

import dataclasses
from typing import Any

from ik_node.interfaces.clock import NS
from ik_node.messages.cdr import deserialize, serialize, time_message

_HEADER = "std_msgs/msg/Header"


def restamped(data: bytes, type_name: str, later_ns: int) -> bytes:
    """A message with shifted header stamps.

    Args:
        data: CDR bytes.
        type_name: Message type.
        later_ns: Shift of every stamp; a stamp of 0, which means "at arrival", is kept.

    Raises:
        InputError: The bytes are no ``type_name``, or a shifted stamp does not fit into a message.
    """
    message = deserialize(data, type_name)
    _shift(message, later_ns)
    return serialize(message)


def _shift(message: Any, later_ns: int) -> None:
    if message.__msgtype__ == _HEADER:
        stamp_ns = int(message.stamp.sec) * NS + int(message.stamp.nanosec)
        if stamp_ns:
            message.stamp = time_message(stamp_ns + later_ns)
        return
    for entry in dataclasses.fields(message):
        value = getattr(message, entry.name)
        for part in value if isinstance(value, list) else (value,):
            if hasattr(part, "__msgtype__"):
                _shift(part, later_ns)

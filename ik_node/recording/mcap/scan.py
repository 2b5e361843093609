"""Where the messages of an MCAP chunk stand, in one compiled pass: most of them are of topics that nobody asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ik_node.jit import compiled

UNKNOWN, UNWANTED, WANTED = 0, 1, 2
"""What there is to say of a channel."""
CHANNELS = 1 << 16
"""So many there may be in a file."""

# Of the MCAP specification.
_SCHEMA, _CHANNEL, _MESSAGE = 0x03, 0x04, 0x05
_OPENING = 9  # opcode, length
_FIXED = 22  # channel, sequence, log time, publish time


@compiled
def _unsigned(data: NDArray[np.uint8], begin: int, size: int) -> Any:
    """The number of ``size`` bytes, low byte first."""
    value = np.uint64(0)
    for index in range(size):
        value |= np.uint64(data[begin + index]) << np.uint64(8 * index)
    return value


@compiled
def wanted_messages(
    records: NDArray[np.uint8], begin: int, channels: NDArray[np.uint8]
) -> tuple[NDArray[np.uint64], int]:
    """The messages of :data:`WANTED` ``channels`` behind ``begin``, and where this stopped.

    It stops at the end, and before a record that has to be looked at first: what describes a channel, a message of an
    :data:`UNKNOWN` one, and a record that is longer than what is left. Rows (k, 6): channel, sequence, log time and
    publish time in ns, begin and end of the content.
    """
    end = len(records)
    found = np.empty(((end - begin) // (_OPENING + _FIXED) + 1, 6), dtype=np.uint64)
    count = 0
    offset = begin
    while offset + _OPENING <= end:
        opcode = records[offset]
        content = offset + _OPENING
        length = np.int64(_unsigned(records, offset + 1, 8))
        if length < 0 or length > end - content or opcode in (_SCHEMA, _CHANNEL):
            break
        if opcode == _MESSAGE:
            if length < _FIXED:
                break
            channel = _unsigned(records, content, 2)
            known = channels[channel]
            if known == UNKNOWN:
                break
            if known == WANTED:
                found[count, 0] = channel
                found[count, 1] = _unsigned(records, content + 2, 4)
                found[count, 2] = _unsigned(records, content + 6, 8)
                found[count, 3] = _unsigned(records, content + 14, 8)
                found[count, 4] = content + _FIXED
                found[count, 5] = content + length
                count += 1
        offset = content + length
    return found[:count], offset

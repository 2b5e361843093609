"""Sequential access to the records of an MCAP file, without its index; the reader and the repair share it.

Layout of records: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from ik_node.errors import RecordingError

OPENING = struct.Struct("<BQ")
"""First bytes of every record: opcode, length of the content."""
_chunk = struct.Struct("<QQQII")
_length = struct.Struct("<Q")
_message = struct.Struct("<HIQQ")
DAMAGE_ERRORS = (struct.error, McapError, ValueError, RuntimeError, zstandard.ZstdError)
"""Raised for the content of a damaged record."""


class ScannedMessage(NamedTuple):
    """A message record; positions count from the start of the scanned bytes."""

    channel: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    offset: int
    """Of the record."""
    begin: int
    """Of the message's data."""
    end: int


def whole_records(stream: BinaryIO, begin: int, skipped: Collection[int] = ()) -> Iterator[tuple[int, int, bytes]]:
    """Reads a file record by record up to the last complete one.

    Args:
        stream: File, which may still be growing.
        begin: Offset of the first record.
        skipped: Opcodes of records whose content is not read.

    Yields:
        Opcode, offset of the next record, and the record with its opening (empty when skipped).
    """
    size = os.fstat(stream.fileno()).st_size
    offset = begin
    stream.seek(begin)
    while True:
        opening = stream.read(OPENING.size)
        if len(opening) < OPENING.size:
            return
        opcode, length = OPENING.unpack(opening)
        offset += OPENING.size + length
        if offset > size:  # cut off, or still being written
            size = os.fstat(stream.fileno()).st_size
        if offset > size:
            return
        if opcode in skipped:
            stream.seek(length, io.SEEK_CUR)
            yield opcode, offset, b""
        else:
            yield opcode, offset, opening + stream.read(length)


def scan_messages(
    records: bytes, channels: Mapping[int, bool], describe: Callable[[Schema | Channel], None]
) -> Iterator[ScannedMessage]:
    """Scans records of a chunk, or a single record.

    Args:
        records: The records.
        channels: Known channels -> whether their messages are yielded; ``describe`` may add to it.
        describe: Called with every schema and channel.

    Yields:
        Message records in their order.

    Raises:
        ValueError: A record exceeds the bytes, or a message belongs to no known channel.
        struct.error: The bytes end within the opening of a record.
    """
    offset, end = 0, len(records)
    while offset < end:
        opcode, length = OPENING.unpack_from(records, offset)
        begin = offset + OPENING.size
        if begin + length > end:
            raise ValueError(f"a record of {length} bytes exceeds its chunk")
        if opcode == Opcode.MESSAGE:
            if length < _message.size:
                raise ValueError(f"a message record has {length} bytes")
            channel, sequence, log_time_ns, publish_time_ns = _message.unpack_from(records, begin)
            wanted = channels.get(channel)
            if wanted is None:
                raise ValueError(f"a message belongs to channel {channel}, which is not described before it")
            if wanted:
                data = begin + _message.size
                yield ScannedMessage(channel, sequence, log_time_ns, publish_time_ns, offset, data, begin + length)
        elif opcode == Opcode.SCHEMA:
            describe(Schema.read(content_stream(records[offset : begin + length])))
        elif opcode == Opcode.CHANNEL:
            describe(Channel.read(content_stream(records[offset : begin + length])))
        offset = begin + length


def content_stream(record: bytes) -> ReadDataStream:
    """The content of a record for the `mcap` library."""
    return ReadDataStream(io.BytesIO(record[OPENING.size :]))


class ChunkUnpacker:
    """Decompresses chunks; one instance per thread."""

    def __init__(self) -> None:
        # Reused for all chunks, since a decompressor allocates work memory.
        self._zstd = zstandard.ZstdDecompressor()

    def unpacked(self, record: bytes) -> bytes:
        """The records in a chunk record; raises ValueError when the chunk is damaged."""
        _, _, size, crc, name_length = _chunk.unpack_from(record, OPENING.size)
        begin = OPENING.size + _chunk.size
        compression = record[begin : begin + name_length]
        begin += name_length
        (compressed_size,) = _length.unpack_from(record, begin)
        begin += _length.size
        records = self._decompressed(compression, record[begin : begin + compressed_size], size)
        if len(records) != size or (crc and zlib.crc32(records) != crc):
            raise ValueError("a chunk does not match its checksum")
        return records

    def _decompressed(self, compression: bytes, data: bytes, size: int) -> bytes:
        if compression == b"zstd":
            return self._zstd.decompress(data, size)
        if compression == b"lz4":
            return bytes(lz4.frame.decompress(data))
        if compression == b"":
            return data
        raise RecordingError(f"unknown chunk compression '{compression.decode()}'; valid: none, lz4, zstd")

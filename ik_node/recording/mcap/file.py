"""One MCAP file in the layout of rosbag2, written chunk by chunk.

The `mcap` library packs every message in Python in the calling thread. Here a message is packed once when it is queued;
the chunk is then joined, checksummed, compressed and written by C code that releases the interpreter lock, so the
writing thread hardly delays the control loop. All other records are packed by the library.
"""

from __future__ import annotations

import fcntl
import struct
import zlib
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from io import FileIO
from pathlib import Path
from typing import NamedTuple, cast

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
PROFILE = "ros2"
_message = struct.Struct("<BQHIQQ")
_message_index = struct.Struct("<BQHI")
_MESSAGE_FIXED = 22  # channel, sequence, log time, publish time
MAX_TIME_NS = 2**63 - 1  # readers hold times as signed numbers

COMPRESSORS: Mapping[str, Callable[[bytes], bytes]] = {
    "none": lambda data: data,
    "lz4": lambda data: bytes(lz4.frame.compress(data)),
    "zstd": lambda data: zstandard.compress(data, 1),
}
"""Name -> compression of a chunk."""


class PendingChunk:
    """Packed messages of the next chunk; filled by one thread, then passed to another."""

    def __init__(self) -> None:
        self.size = 0
        """Size of all records in bytes."""
        self.count = 0
        self._pieces: list[bytes] = []
        self._index: dict[int, array[int]] = {}

    def add(self, channel: int, sequence: int, log_time_ns: int, publish_time_ns: int, data: bytes) -> None:
        """Appends a message record."""
        index = self._index.get(channel)
        if index is None:
            index = self._index[channel] = array("Q")
        index.extend((log_time_ns, self.size))
        length = len(data)
        self._pieces.append(
            _message.pack(Opcode.MESSAGE, _MESSAGE_FIXED + length, channel, sequence, log_time_ns, publish_time_ns)
        )
        self._pieces.append(data)
        self.size += _message.size + length
        self.count += 1

    def records(self) -> bytes:
        """The concatenated message records."""
        return b"".join(self._pieces)

    def index(self) -> dict[int, array[int]]:
        """Channel -> log time, offset, log time, offset, ..."""
        return self._index

    def span(self) -> tuple[int, int]:
        """Lowest and highest log time; the chunk must not be empty."""
        times = [(min(entries[::2]), max(entries[::2])) for entries in self._index.values()]
        return min(low for low, _ in times), max(high for _, high in times)


@dataclass
class Content:
    """Content of a file so far."""

    schemas: list[Schema] = field(default_factory=list)
    channels: list[Channel] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    chunk_count: int = 0
    chunk_index: bytearray = field(default_factory=bytearray)
    """Packed index records of all chunks; one day of recording has a million."""
    metadata: list[MetadataIndex] = field(default_factory=list)
    start_ns: int = MAX_TIME_NS
    end_ns: int = 0

    def add_chunk(self, index: ChunkIndex) -> None:
        """Adds a chunk, without the counts of its messages."""
        self.chunk_count += 1
        self.chunk_index += _packed(index)
        self.start_ns = min(self.start_ns, index.message_start_time)
        self.end_ns = max(self.end_ns, index.message_end_time)

    def schema_of(self, channel: Channel) -> str:
        """Type of a channel's messages."""
        return next((schema.name for schema in self.schemas if schema.id == channel.schema_id), "")

    @property
    def message_count(self) -> int:
        """Messages on all channels."""
        return sum(self.counts.values())


class ChannelInfo(NamedTuple):
    """Description of a topic in a file."""

    topic: str
    type_name: str
    definition: str
    metadata: Mapping[str, str]


class McapFile:
    """A file being written; every method may raise OSError.

    The file is locked meanwhile, so that it is not repaired.
    """

    def __init__(self, path: Path, mode: str, content: Content, size: int) -> None:
        """See :meth:`create` and :meth:`resume`."""
        self.path = path
        self.content = content
        self.size = size
        self._compression, self._compress = "", COMPRESSORS["none"]
        self._file = cast(FileIO, path.open(mode, buffering=0))
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            raise
        except OSError:  # a file system without locks
            pass

    @classmethod
    def create(cls, path: Path, library: str, compression: str) -> McapFile:
        """Creates a file; ``path`` must not exist. ``compression`` is a key of :data:`COMPRESSORS`."""
        file = cls(path, "xb", Content(), 0)
        file._compression = "" if compression == "none" else compression
        file._compress = COMPRESSORS[compression]
        file._put(MAGIC + _packed(Header(PROFILE, library)))
        return file

    @classmethod
    def resume(cls, path: Path, content: Content, size: int) -> McapFile:
        """Opens a file to complete it; raises BlockingIOError when it is being written.

        Args:
            path: The file.
            content: Content of its data section.
            size: Size up to which the data section is valid; the rest is cut off.
        """
        file = cls(path, "r+b", content, size)
        file._file.truncate(size)
        file._file.seek(size)
        return file

    def add_channel(self, info: ChannelInfo) -> None:
        """Writes a channel; ids are consecutive from 1."""
        content = self.content
        schema = next((entry for entry in content.schemas if entry.name == info.type_name), None)
        records = b""
        if schema is None:
            schema = Schema(
                id=len(content.schemas) + 1, name=info.type_name, encoding="ros2msg", data=info.definition.encode()
            )
            content.schemas.append(schema)
            records = _packed(schema)
        channel = Channel(
            id=len(content.channels) + 1,
            topic=info.topic,
            message_encoding="cdr",
            schema_id=schema.id,
            metadata=dict(info.metadata),
        )
        content.channels.append(channel)
        content.counts[channel.id] = 0
        self._put(records + _packed(channel))

    def add_chunk(self, pending: PendingChunk) -> None:
        """Writes a chunk with its message indexes in one call; an empty chunk is skipped."""
        if not pending.count:
            return
        records = pending.records()
        start_ns, end_ns = pending.span()
        data = self._compress(records)
        chunk = _packed(
            Chunk(
                compression=self._compression,
                data=data,
                message_start_time=start_ns,
                message_end_time=end_ns,
                uncompressed_crc=zlib.crc32(records),
                uncompressed_size=len(records),
            )
        )
        begin = self.size
        offsets: dict[int, int] = {}
        pieces = [chunk]
        offset = begin + len(chunk)
        for channel, entries in pending.index().items():
            piece = _index_record(channel, entries)
            offsets[channel] = offset
            offset += len(piece)
            pieces.append(piece)
        self._put(b"".join(pieces))
        content = self.content
        for channel, entries in pending.index().items():
            content.counts[channel] += len(entries) // 2
        content.add_chunk(
            ChunkIndex(
                chunk_length=len(chunk),
                chunk_start_offset=begin,
                compression=self._compression,
                compressed_size=len(data),
                message_end_time=end_ns,
                message_index_length=offset - begin - len(chunk),
                message_index_offsets=offsets,
                message_start_time=start_ns,
                uncompressed_size=len(records),
            )
        )

    def add_indexes(self, indexes: Mapping[int, array[int]]) -> dict[int, int]:
        """Writes message indexes of the last chunk during a repair; returns channel -> offset."""
        offsets = {}
        for channel, entries in indexes.items():
            offsets[channel] = self.size
            self._put(_index_record(channel, entries))
        return offsets

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Writes a metadata record."""
        record = _packed(Metadata(name=name, metadata=dict(values)))
        self.content.metadata.append(MetadataIndex(offset=self.size, length=len(record), name=name))
        self._put(record)

    def finish(self) -> None:
        """Writes summary and footer, and closes."""
        self._put(_packed(DataEnd(0)))
        self._put(_summary(self.content, self.size) + MAGIC)
        self._file.close()
        self.content.chunk_index.clear()

    def abandon(self) -> None:
        """Closes without a summary."""
        self._file.close()

    def _put(self, data: bytes) -> None:
        """Writes all bytes or none: after an error the file is truncated to its last complete record."""
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) or 0 :]
        except OSError:
            self._file.truncate(self.size)
            self._file.seek(self.size)
            raise
        self.size += len(data)


def _packed(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _index_record(channel: int, entries: array[int]) -> bytes:
    size = 8 * len(entries)
    return _message_index.pack(Opcode.MESSAGE_INDEX, 6 + size, channel, size) + entries.tobytes()


def _summary(content: Content, begin: int) -> bytes:
    """Schemas, channels, statistics, indexes and footer of a summary section at offset ``begin``."""
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(content.channels),
        channel_message_counts=dict(content.counts),
        chunk_count=content.chunk_count,
        message_count=content.message_count,
        message_end_time=content.end_ns,
        message_start_time=content.start_ns if content.message_count else 0,
        metadata_count=len(content.metadata),
        schema_count=len(content.schemas),
    )
    groups = (
        (Opcode.SCHEMA, b"".join(map(_packed, content.schemas))),
        (Opcode.CHANNEL, b"".join(map(_packed, content.channels))),
        (Opcode.STATISTICS, _packed(statistics)),
        (Opcode.CHUNK_INDEX, bytes(content.chunk_index)),
        (Opcode.METADATA_INDEX, b"".join(map(_packed, content.metadata))),
    )
    offset_start, offsets = begin, b""
    for opcode, records in groups:
        if records:
            offsets += _packed(SummaryOffset(group_opcode=opcode, group_start=offset_start, group_length=len(records)))
            offset_start += len(records)
    summary = b"".join(records for _, records in groups) + offsets
    opening = struct.pack("<BQQQ", Opcode.FOOTER, 20, begin, offset_start)
    crc = zlib.crc32(opening, zlib.crc32(summary))
    return summary + _packed(Footer(summary_crc=crc, summary_offset_start=offset_start, summary_start=begin))


__all__ = ["COMPRESSORS", "MAGIC", "ChannelInfo", "Content", "McapFile", "PendingChunk"]

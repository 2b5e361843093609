"""Repair of recordings that were cut off: a killed process leaves a file without index and no ``metadata.yaml``.

A file is repaired in place: its complete records stay, and the missing indexes are appended after the last of them. A
repair that was interrupted can be repeated.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, MessageIndex, Metadata, MetadataIndex, Schema

from ik_node.errors import InputError, RecordingError
from ik_node.recording.mcap.file import MAGIC, Content, McapFile
from ik_node.recording.mcap.metadata import (
    DROPPED,
    RECORD_NAME,
    REPAIRED,
    PartInfo,
    bag_metadata,
    metadata_record,
    write_metadata,
)
from ik_node.recording.mcap.reader import Recording, part_files
from ik_node.recording.mcap.scan import (
    DAMAGE_ERRORS,
    OPENING,
    ChunkUnpacker,
    content_stream,
    scan_messages,
    whole_records,
)
from ik_node.settings.yaml_text import load_yaml

_LEAST_ZEROS, _MOST_ZEROS = 512, 1 << 26
"""File systems fill blocks with zeros after a power cut; records contain no runs of this length."""


class PartRepair(NamedTuple):
    """Result for one file."""

    name: str
    messages: int
    """Number of messages in the file."""
    end_ns: int
    """ROS time of the last message; 0 for none."""
    removed_bytes: int
    """Size of the unfinished last record."""
    was_complete: bool
    missing: int
    """Messages left out by the writer, from gaps in their sequence numbers; only for files of this package."""


class Repair(NamedTuple):
    """Result for a recording."""

    parts: tuple[PartRepair, ...]
    ignored: tuple[str, ...]
    """Empty files."""
    was_complete: bool
    """The recording was complete; nothing was changed."""


def repair(path: Path) -> Repair:
    """Completes a recording that was cut off.

    Args:
        path: Folder or file.

    Returns:
        What was repaired.

    Raises:
        RecordingError: ``path`` is no recording, is being written, cannot be written, or is damaged elsewhere than at
            its end; damaged files are not changed.
    """
    files = part_files(path)
    ignored = [file for file in files if file.stat().st_size <= len(MAGIC)]
    files = [file for file in files if file not in ignored]
    if files and Recording(path).complete:
        return Repair((), (), True)
    if not files:
        raise RecordingError(f"'{path}' contains nothing that can be repaired")
    custom: dict[str, str] = {}
    done: list[PartRepair] = []
    contents: list[PartInfo] = []
    try:
        for file in files:
            scan = _Scan(file)
            custom |= scan.custom
            done.append(_part_repair(scan))
            if not scan.complete:
                _complete(scan)
            contents.append(PartInfo(file.name, scan.content))
        if path.is_dir():
            custom[DROPPED] = str(sum(part.missing for part in done))
            removed = sum(part.removed_bytes for part in done)
            custom[REPAIRED] = f"{removed} bytes of an unfinished record removed"
            write_metadata(path, bag_metadata(contents, custom))
    except BlockingIOError as error:
        raise RecordingError(f"'{path}' is being written and was not changed") from error
    except OSError as error:
        raise RecordingError(f"'{path}' cannot be repaired: {error.strerror}") from error
    return Repair(tuple(done), tuple(file.name for file in ignored), False)


def _part_repair(scan: _Scan) -> PartRepair:
    content = scan.content
    return PartRepair(
        scan.path.name,
        content.message_count,
        content.end_ns,
        0 if scan.complete else scan.path.stat().st_size - scan.size,
        scan.complete,
        scan.missing if RECORD_NAME in scan.records_named and "ik_node" in scan.custom else 0,
    )


def _complete(scan: _Scan) -> None:
    """Appends the missing records after the last complete one."""
    file = McapFile.resume(scan.path, scan.content, scan.size)
    scan.end_chunk(file)
    values = {**scan.custom, REPAIRED: "index rebuilt"}
    file.add_metadata(RECORD_NAME, metadata_record(bag_metadata([PartInfo(scan.path.name, scan.content)], values)))
    file.finish()


@dataclass
class _OpenChunk:
    """A chunk whose message indexes may still follow."""

    begin: int
    length: int
    chunk: Chunk
    indexes: dict[int, array[int]]
    """Channel -> log time, offset, log time, offset, ..."""
    offsets: dict[int, int] = field(default_factory=dict)
    """Channel -> offset of its message index."""
    end: int = 0
    """End of the last message index."""


class _Scan:
    """The complete records of a file."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when it is no MCAP file, or damaged before its end."""
        self.path = path
        self.content = Content()
        self.size = len(MAGIC)
        """Size up to the last complete record."""
        self.complete = False
        self.custom: dict[str, str] = {}
        self.records_named: set[str] = set()
        self.missing = 0
        self._expected: dict[int, int] = {}
        self._open: _OpenChunk | None = None
        self._chunks = ChunkUnpacker()
        self._channels: dict[int, bool] = {}
        try:
            with path.open("rb") as stream:
                self._read(stream)
        except OSError as error:
            raise RecordingError(f"'{path}' cannot be read: {error.strerror}") from error

    def end_chunk(self, file: McapFile | None) -> None:
        """Ends the last chunk, of which no further index follows; missing indexes are written to ``file``."""
        last, self._open = self._open, None
        if last is None:
            return
        end = max(last.end, last.begin + last.length)
        left_out = set(last.indexes) - set(last.offsets)
        if left_out and file is not None:
            last.offsets |= file.add_indexes({channel: last.indexes[channel] for channel in sorted(left_out)})
            end = file.size
        self.content.add_chunk(
            ChunkIndex(
                chunk_length=last.length,
                chunk_start_offset=last.begin,
                compression=last.chunk.compression,
                compressed_size=len(last.chunk.data),
                message_end_time=last.chunk.message_end_time,
                message_index_length=end - last.begin - last.length,
                message_index_offsets=last.offsets,
                message_start_time=last.chunk.message_start_time,
                uncompressed_size=last.chunk.uncompressed_size,
            )
        )

    def _read(self, stream: BinaryIO) -> None:
        if stream.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"'{self.path}' is no MCAP file")
        size = self.path.stat().st_size
        written = _size_without_zeros(stream, size)
        stream.seek(max(len(MAGIC), size - len(MAGIC)))
        has_footer = stream.read() == MAGIC
        for opcode, end, record in whole_records(stream, self.size):
            if opcode == 0 or (opcode != Opcode.CHUNK and end > written):  # only chunks have a checksum
                break
            if opcode == Opcode.DATA_END:
                self.complete = has_footer
                break
            try:
                self._add_record(opcode, record)
            except DAMAGE_ERRORS as error:
                self._raise_if_more_follows(stream, size, len(record), error)
                break
            self.size += len(record)
        if self.complete:
            self.end_chunk(None)

    def _raise_if_more_follows(self, stream: BinaryIO, size: int, length: int, error: Exception) -> None:
        """Raises RecordingError unless the damaged record is the last one, as in a file that was cut off."""
        opening = stream.read(OPENING.size)
        if len(opening) == OPENING.size:
            opcode, next_length = OPENING.unpack(opening)
            if 0 < opcode <= Opcode.DATA_END and self.size + length + OPENING.size + next_length <= size:
                raise RecordingError(
                    f"'{self.path}' is damaged after byte {self.size}, not cut off: {error}"
                ) from error

    def _add_record(self, opcode: int, record: bytes) -> None:
        if opcode == Opcode.MESSAGE_INDEX and self._open is not None:
            index = MessageIndex.read(content_stream(record))
            self._open.offsets[index.channel_id] = self.size
            self._open.end = self.size + len(record)
            return
        self.end_chunk(None)
        if opcode == Opcode.CHUNK:
            indexes = self._add_messages(self._chunks.unpacked(record))
            self._open = _OpenChunk(self.size, len(record), Chunk.read(content_stream(record)), indexes)
        elif opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            self._add_messages(record)
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(content_stream(record))
            self.content.metadata.append(MetadataIndex(offset=self.size, length=len(record), name=metadata.name))
            self.records_named.add(metadata.name)
            if metadata.name == RECORD_NAME:
                self.custom |= _custom(metadata.metadata.get("serialized_metadata", ""))

    def _add_messages(self, records: bytes) -> dict[int, array[int]]:
        """Counts messages; returns channel -> log time, offset, log time, offset, ..."""
        indexes: dict[int, array[int]] = {}
        content = self.content
        for message in scan_messages(records, self._channels, self._describe):
            indexes.setdefault(message.channel, array("Q")).extend((message.log_time_ns, message.offset))
            self.missing += max(0, message.sequence - self._expected.get(message.channel, message.sequence))
            self._expected[message.channel] = message.sequence + 1
        for channel, entries in indexes.items():
            content.counts[channel] += len(entries) // 2
            content.start_ns = min(content.start_ns, *entries[::2])
            content.end_ns = max(content.end_ns, *entries[::2])
        return indexes

    def _describe(self, record: Schema | Channel) -> None:
        content = self.content
        if isinstance(record, Schema):
            if all(schema.id != record.id for schema in content.schemas):
                content.schemas.append(record)
        elif record.id not in content.counts:
            content.channels.append(record)
            content.counts[record.id] = 0
            self._channels[record.id] = True


def _size_without_zeros(stream: BinaryIO, size: int) -> int:
    """Size without the zeros that a power cut may leave at the end."""
    stream.seek(max(0, size - _MOST_ZEROS))
    end = stream.read()
    zeros = len(end) - len(end.rstrip(b"\0"))
    return size - zeros if zeros >= _LEAST_ZEROS else size


def _custom(text: str) -> dict[str, str]:
    """``custom_data`` in the metadata record of a file."""
    try:
        metadata: Any = load_yaml(text)
        return {str(key): str(value) for key, value in (metadata["custom_data"] or {}).items()}
    except (InputError, KeyError, TypeError, AttributeError):
        return {}

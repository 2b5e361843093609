"""Reads MCAP recordings, whole ones and those that were cut off while being written.

Files are read from front to back, without their index: a killed writer left none, and nothing of a run is to be
skipped. Messages come in the order in which they were written.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from ik_node.errors import RecordingError
from ik_node.recording.mcap.file import MAGIC
from ik_node.recording.mcap.metadata import METADATA_FILE, ROOT, STORAGE
from ik_node.recording.mcap.scan import CHANNELS, UNKNOWN, UNWANTED, WANTED, wanted_messages

_record = struct.Struct("<BQ")
_chunk = struct.Struct("<QQQII")
_length = struct.Struct("<Q")
_message_channel = struct.Struct("<HIQQ")
_TELLING = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK)
_PART = re.compile(r"_(\d+)\.mcap$")


class Topic(NamedTuple):
    """A topic of a file."""

    name: str
    type_name: str


class RecordedMessage(NamedTuple):
    """One message as it stands in a recording."""

    topic: str
    type_name: str
    data: bytes
    """CDR."""
    log_time_ns: int
    """When it was received or made, ROS time."""
    publish_time_ns: int
    sequence: int


class Part:
    """One MCAP file."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when ``path`` cannot be read or is no MCAP file."""
        self.path = path
        try:
            with path.open("rb") as stream:
                begin = stream.read(len(MAGIC))
                stream.seek(max(0, path.stat().st_size - len(MAGIC)))
                self.complete = stream.read() == MAGIC and path.stat().st_size > len(MAGIC)
                """Has its footer; otherwise it was cut off."""
        except OSError as error:
            raise RecordingError(f"'{path}' cannot be read: {error.strerror}") from error
        if begin != MAGIC[: len(begin)]:
            raise RecordingError(f"'{path}' is no MCAP file")
        self.topics: dict[int, Topic] = {}
        """Channel -> topic, as far as the file was read."""
        self.readable_bytes = 0
        """Up to where the records read so far are whole."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Every whole message (of ``topics``), in the order in which it was written.

        Ends where a cut-off file ends. Raises RecordingError when a complete file is damaged.
        """
        reading, chunks = _Reading(self.topics, topics), Unpacker()
        try:
            with self.path.open("rb") as stream:
                for opcode, record in self._records(stream):
                    yield from reading.messages(chunks.unpacked(record) if opcode == Opcode.CHUNK else record)
        except (struct.error, McapError, ValueError, RuntimeError, zstandard.ZstdError) as error:
            if self.complete:
                raise RecordingError(f"'{self.path}' is damaged behind byte {self.readable_bytes}: {error}") from error

    def counts(self) -> dict[Topic, int]:
        """Topic -> number of messages; from the index where there is one, else by reading everything."""
        summary = self._summary()
        if summary is not None and summary.statistics is not None:
            found = summary.statistics.channel_message_counts
            return {
                Topic(channel.topic, summary.schemas[channel.schema_id].name): found.get(number, 0)
                for number, channel in summary.channels.items()
                if channel.schema_id in summary.schemas
            }
        counts: dict[Topic, int] = {}
        for message in self.messages():
            topic = Topic(message.topic, message.type_name)
            counts[topic] = counts.get(topic, 0) + 1
        return counts

    def _summary(self) -> Summary | None:
        if not self.complete:
            return None
        try:
            with self.path.open("rb") as stream:
                return make_reader(stream).get_summary()
        except (McapError, struct.error, ValueError, KeyError):  # a damaged index: what matters is the data before it
            return None

    def _records(self, stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
        """Every whole record of the data section that tells of messages, with its opcode and length."""
        size = self._size()
        self.readable_bytes = len(MAGIC)
        stream.seek(self.readable_bytes)
        while True:
            opening = stream.read(_record.size)
            if len(opening) < _record.size:
                return
            opcode, length = _record.unpack(opening)
            end = self.readable_bytes + _record.size + length
            if end > size:  # or somebody is still writing
                size = self._size()
            if end > size or opcode == Opcode.DATA_END:
                return
            if opcode in _TELLING:
                content = stream.read(length)
                if len(content) < length:
                    return
                yield opcode, opening + content
            else:
                stream.seek(length, io.SEEK_CUR)
            self.readable_bytes = end

    def _size(self) -> int:
        return self.path.stat().st_size


class Unpacker:
    """Takes chunks apart. One instance belongs to one thread."""

    def __init__(self) -> None:
        # One for all chunks: what it works in need not be made anew for each.
        self._zstd = zstandard.ZstdDecompressor()

    def unpacked(self, record: bytes) -> bytes:
        """The records in a whole chunk record; ValueError when they are damaged."""
        _, _, size, crc, name_length = _chunk.unpack_from(record, _record.size)
        begin = _record.size + _chunk.size
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
        raise RecordingError(f"chunk compression '{compression.decode()}' is not known; valid: none, lz4, zstd")


class _Reading:
    """Messages out of records, with what earlier records said of channels."""

    def __init__(self, topics: dict[int, Topic], wanted: Collection[str] | None) -> None:
        self._topics = topics
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._channels = np.full(CHANNELS, UNKNOWN, dtype=np.uint8)

    def messages(self, records: bytes) -> Iterator[RecordedMessage]:
        """The messages among ``records``; ValueError when one is of no channel, or cut off."""
        offset, end, topics = 0, len(records), self._topics
        while offset < end:
            rows, offset = wanted_messages(np.frombuffer(records, np.uint8), offset, self._channels)
            for channel, sequence, log_time_ns, publish_time_ns, begin, behind in rows.tolist():
                name, type_name = topics[channel]
                yield RecordedMessage(name, type_name, records[begin:behind], log_time_ns, publish_time_ns, sequence)
            if offset < end:
                offset = self._describe(records, offset)

    def _describe(self, records: bytes, offset: int) -> int:
        """Takes what the record at ``offset`` says of a channel; returns where the next record begins."""
        opcode, length = _record.unpack_from(records, offset)
        begin = offset + _record.size
        if begin + length > len(records):
            raise ValueError(f"a record of {length} bytes runs past the end of its chunk")
        content = records[begin : begin + length]
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(content))
            self._schemas[schema.id] = schema.name
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(_stream(content))
            topic = Topic(channel.topic, self._schemas.get(channel.schema_id, ""))
            self._topics[channel.id] = topic
            wanted = self._wanted is None or topic.name in self._wanted
            self._channels[channel.id] = WANTED if wanted else UNWANTED
        else:
            number, *_ = _message_channel.unpack_from(content)
            raise ValueError(f"a message is of channel {number}, which is not described before it")
        return begin + int(length)


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


class Recording:
    """A recording on disk: a directory, or one of its files."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when there is no recording at ``path``."""
        self.path = path
        metadata = _read_metadata(path) if path.is_dir() else {}
        self.parts = [Part(file) for file in part_files(path, metadata)]
        self.custom: dict[str, str] = {key: str(value) for key, value in (metadata.get("custom_data") or {}).items()}
        """``custom_data`` of ``metadata.yaml``."""
        self.complete = bool(metadata or path.is_file()) and all(part.complete for part in self.parts)
        """Closed by its writer: every file has its footer, and ``metadata.yaml`` is there."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Every message (of ``topics``) of all files, in the order in which it was written."""
        for part in self.parts:
            yield from part.messages(topics)

    def counts(self) -> dict[Topic, int]:
        """Topic -> number of messages."""
        counts: dict[Topic, int] = {}
        for part in self.parts:
            for topic, count in part.counts().items():
                counts[topic] = counts.get(topic, 0) + count
        return counts


def _read_metadata(directory: Path) -> dict[str, Any]:
    file = directory / METADATA_FILE
    try:
        metadata = yaml.safe_load(file.read_text())[ROOT]
        if metadata["storage_identifier"] != STORAGE:
            storage = metadata["storage_identifier"]
            raise RecordingError(f"'{directory}' is stored as {storage}; only {STORAGE} is read here")
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RecordingError(f"'{file}' cannot be read: {error.strerror}") from error
    except (yaml.YAMLError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise RecordingError(f"'{file}' is no metadata of a recording: {error}") from error
    return dict(metadata)


def part_files(path: Path, metadata: Mapping[str, Any] | None = None) -> list[Path]:
    """The files of a recording in their order; RecordingError when there is none."""
    if path.is_file():
        return [path]
    names = (metadata or {}).get("relative_file_paths")
    if isinstance(names, list):
        return [path / str(name) for name in names]
    found = [(match, file) for file in path.glob("*.mcap") if (match := _PART.search(file.name))]
    if not found:
        what = "holds no MCAP file of a recording" if path.is_dir() else "does not exist"
        raise RecordingError(f"'{path}' {what}")
    return [file for match, file in sorted(found, key=lambda pair: int(pair[0][1]))]

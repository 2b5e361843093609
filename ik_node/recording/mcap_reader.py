"""Reads MCAP recordings, whole ones and those that were cut off while being written.

Files are read from front to back, without their index: a killed writer left none, and nothing of a run is to be
skipped. Messages come in the order in which they were written.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable, Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import yaml
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from ik_node.errors import RecordingError
from ik_node.recording.bag_metadata import METADATA_FILE, ROOT, STORAGE
from ik_node.recording.mcap_file import MAGIC

_record = struct.Struct("<BQ")
_message = struct.Struct("<BQHIQQ")
_chunk = struct.Struct("<QQQII")
_length = struct.Struct("<Q")
_PART = re.compile(r"_(\d+)\.mcap$")

DECOMPRESSORS: Mapping[bytes, Callable[[bytes, int], bytes]] = {
    b"": lambda data, size: data,
    b"lz4": lambda data, size: bytes(lz4.frame.decompress(data)),
    b"zstd": zstandard.decompress,
}


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
        reading = _Reading(self.topics, topics)
        try:
            with self.path.open("rb") as stream:
                for opcode, record in self._records(stream):
                    yield from reading.messages(unpacked(record[_record.size :]) if opcode == Opcode.CHUNK else record)
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
        """Every whole record of the data section, with its opcode and length."""
        self.readable_bytes = len(MAGIC)
        stream.seek(self.readable_bytes)
        while True:
            opening = stream.read(_record.size)
            if len(opening) < _record.size:
                return
            opcode, length = _record.unpack(opening)
            content = stream.read(length) if length < self._remaining() else b""
            if len(content) < length or opcode == Opcode.DATA_END:
                return
            yield opcode, opening + content
            self.readable_bytes += _record.size + length

    def _remaining(self) -> int:
        return self.path.stat().st_size - self.readable_bytes


def unpacked(content: bytes) -> bytes:
    """The records of a chunk; ValueError when they are damaged."""
    _, _, size, crc, name_length = _chunk.unpack_from(content)
    begin = _chunk.size + name_length
    compression = content[_chunk.size : begin]
    if compression not in DECOMPRESSORS:
        raise RecordingError(f"chunk compression '{compression.decode()}' is not known; valid: none, lz4, zstd")
    (compressed_size,) = _length.unpack_from(content, begin)
    begin += _length.size
    records = DECOMPRESSORS[compression](content[begin : begin + compressed_size], size)
    if len(records) != size or (crc and zlib.crc32(records) != crc):
        raise ValueError("a chunk does not match its checksum")
    return records


class _Reading:
    """Messages out of records, with what earlier records said of channels."""

    def __init__(self, topics: dict[int, Topic], wanted: Collection[str] | None) -> None:
        self._topics = topics
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._of_interest: dict[int, Topic | None] = {}

    def messages(self, records: bytes) -> Iterator[RecordedMessage]:
        """The messages among ``records``; ValueError when one is of no channel."""
        offset, end, of_interest = 0, len(records), self._of_interest
        while offset < end:
            opcode, length = _record.unpack_from(records, offset)
            if opcode == Opcode.MESSAGE:
                _, _, channel, sequence, log_time_ns, publish_time_ns = _message.unpack_from(records, offset)
                if channel not in of_interest:
                    raise ValueError(f"a message is of channel {channel}, which is not described before it")
                topic = of_interest[channel]
                if topic is not None:
                    data = records[offset + _message.size : offset + _record.size + length]
                    yield RecordedMessage(topic[0], topic[1], data, log_time_ns, publish_time_ns, sequence)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._describe(opcode, records[offset + _record.size : offset + _record.size + length])
            offset += _record.size + length

    def _describe(self, opcode: int, content: bytes) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(content))
            self._schemas[schema.id] = schema.name
            return
        channel = Channel.read(_stream(content))
        topic = Topic(channel.topic, self._schemas.get(channel.schema_id, ""))
        self._topics[channel.id] = topic
        wanted = self._wanted is None or topic.name in self._wanted
        self._of_interest[channel.id] = topic if wanted else None


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

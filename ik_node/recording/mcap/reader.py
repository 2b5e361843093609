"""Reader of MCAP recordings, complete ones and those that were cut off while being written.

Files are read from front to back without their index, because a killed writer leaves none. Messages are returned in the
order in which they were written.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.summary import Summary

from ik_node.errors import InputError, RecordingError
from ik_node.recording.mcap.file import MAGIC
from ik_node.recording.mcap.metadata import DROPPED, METADATA_FILE, ROOT, STORAGE
from ik_node.recording.mcap.scan import DAMAGE_ERRORS, ChunkUnpacker, scan_messages, whole_records
from ik_node.settings.yaml_text import bounded_text, load_yaml

_SKIPPED = (Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA)
"""Records without messages."""
_PART = re.compile(r"_(\d+)\.mcap$")


class Topic(NamedTuple):
    """A topic of a file."""

    name: str
    type_name: str


class RecordedMessage(NamedTuple):
    """A message of a recording."""

    topic: str
    type_name: str
    data: bytes
    """CDR."""
    log_time_ns: int
    """ROS time at which it was received or created."""
    publish_time_ns: int
    sequence: int


class McapPart:
    """One MCAP file."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when ``path`` cannot be read or is no MCAP file."""
        self.path = path
        try:
            with path.open("rb") as stream:
                begin = stream.read(len(MAGIC))
                stream.seek(max(0, path.stat().st_size - len(MAGIC)))
                self.complete = stream.read() == MAGIC and path.stat().st_size > len(MAGIC)
                """True when the file has its footer; otherwise it was cut off."""
        except OSError as error:
            raise RecordingError(f"'{path}' cannot be read: {error.strerror}") from error
        if begin != MAGIC[: len(begin)]:
            raise RecordingError(f"'{path}' is no MCAP file")
        self.topics: dict[int, Topic] = {}
        """Channel -> topic, for the part read so far."""
        self.readable_bytes = 0
        """Offset behind the last record that was read."""

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """The messages in the order in which they were written.

        Args:
            topics: Names of the topics to read; default: all.

        Yields:
            Messages up to the last complete record.

        Raises:
            RecordingError: A file that was closed by its writer is damaged.
        """
        selected, chunks = _MessageFilter(self.topics, topics), ChunkUnpacker()
        self.readable_bytes = len(MAGIC)
        try:
            with self.path.open("rb") as stream:
                for opcode, end, record in whole_records(stream, len(MAGIC), _SKIPPED):
                    if opcode == Opcode.DATA_END:
                        return
                    if opcode == Opcode.CHUNK:
                        yield from selected.messages(chunks.unpacked(record))
                    elif record:
                        yield from selected.messages(record)
                    self.readable_bytes = end
        except DAMAGE_ERRORS as error:
            if self.complete:
                raise RecordingError(f"'{self.path}' is damaged after byte {self.readable_bytes}: {error}") from error

    def counts(self) -> dict[Topic, int]:
        """Topic -> number of messages; from the summary if the file has one."""
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
        except (McapError, struct.error, ValueError, KeyError):  # a damaged summary; the messages precede it
            return None


class _MessageFilter:
    """Selects messages of the wanted topics; keeps the channels described so far."""

    def __init__(self, topics: dict[int, Topic], wanted: Collection[str] | None) -> None:
        self._topics = topics
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, bool] = {}

    def messages(self, records: bytes) -> Iterator[RecordedMessage]:
        """The wanted messages; raises ValueError as :func:`scan_messages` does."""
        topics = self._topics
        for channel, sequence, log_time_ns, publish_time_ns, _, begin, end in scan_messages(
            records, self._channels, self._describe
        ):
            name, type_name = topics[channel]
            yield RecordedMessage(name, type_name, records[begin:end], log_time_ns, publish_time_ns, sequence)

    def _describe(self, record: Schema | Channel) -> None:
        if isinstance(record, Schema):
            self._schemas[record.id] = record.name
            return
        topic = Topic(record.topic, self._schemas.get(record.schema_id, ""))
        self._topics[record.id] = topic
        self._channels[record.id] = self._wanted is None or topic.name in self._wanted


class Recording:
    """A recording on disk: a folder, or one of its files."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError when there is no recording at ``path``."""
        self.path = path
        metadata = _read_metadata(path) if path.is_dir() else {}
        self.parts = [McapPart(file) for file in part_files(path, metadata)]
        self.custom: dict[str, str] = {
            str(key): str(value) for key, value in (metadata.get("custom_data") or {}).items()
        }
        """``custom_data`` of ``metadata.yaml``."""
        self.complete = bool(metadata or path.is_file()) and all(part.complete for part in self.parts)
        """True when the writer closed it: every file has its footer and ``metadata.yaml`` exists."""

    @property
    def dropped(self) -> int:
        """Number of messages that the writer left out; raises RecordingError when ``metadata.yaml`` has no number."""
        text = self.custom.get(DROPPED, "0")
        try:
            return int(text)
        except ValueError as error:
            raise RecordingError(f"'{self.path}': custom_data.{DROPPED} is '{text}'; expected a number") from error

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """The messages of all files, as :meth:`McapPart.messages`."""
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
        content = load_yaml(bounded_text(file))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RecordingError(f"'{file}' cannot be read: {error.strerror}") from error
    except InputError as error:
        raise RecordingError(f"'{file}' is not the metadata of a recording: {error}") from error
    metadata = content.get(ROOT) if isinstance(content, dict) else None
    if not isinstance(metadata, dict):
        raise RecordingError(f"'{file}' is not the metadata of a recording: it has no mapping '{ROOT}'")
    storage = metadata.get("storage_identifier")
    if storage != STORAGE:
        said = f"stored as {storage}" if storage else "without a storage_identifier"
        raise RecordingError(f"'{directory}' is {said}; only {STORAGE} is supported")
    names, custom = metadata.get("relative_file_paths"), metadata.get("custom_data")
    if not isinstance(names, list) or not names:
        raise RecordingError(f"'{file}' has no list relative_file_paths; name a file, or use ros2 bag reindex")
    if custom is not None and not isinstance(custom, dict):
        raise RecordingError(f"'{file}': custom_data is no mapping")
    return metadata


def part_files(path: Path, metadata: Mapping[str, Any] | None = None) -> list[Path]:
    """The files of a recording in their order.

    Args:
        path: Folder or file.
        metadata: Content of ``metadata.yaml``; its names are names of files in that folder.

    Raises:
        RecordingError: There is no file, or a name leads out of the folder.
    """
    if path.is_file():
        return [path]
    if metadata:
        return [inside(path, name) for name in metadata["relative_file_paths"]]
    try:
        found = [(match, file) for file in path.iterdir() if (match := _PART.search(file.name))]
    except (FileNotFoundError, ValueError):  # ValueError: a NUL byte in the name
        raise RecordingError(f"'{path}' does not exist") from None
    except OSError as error:
        raise RecordingError(f"'{path}' cannot be read: {error.strerror}") from error
    if not found:
        raise RecordingError(f"'{path}' contains no MCAP file of a recording")
    return [inside(path, file.name) for match, file in sorted(found, key=lambda pair: int(pair[0][1]))]


def inside(directory: Path, name: Any) -> Path:
    """A regular file of a folder.

    Args:
        directory: Folder of a recording, perhaps of somebody else.
        name: Name of a file in it, as ``metadata.yaml`` has it.

    Raises:
        RecordingError: The name leads out of the folder or to a device; such a file is neither read nor written.
    """
    if not isinstance(name, str) or not name.isprintable() or name in ("", ".", "..") or set("/\\") & set(name):
        raise RecordingError(f"'{directory}' names the file {name!r}; expected the name of a file in that folder")
    file = directory / name
    try:
        if file.resolve().parent != directory.resolve():
            raise RecordingError(f"'{file}' leads out of the folder; name the file itself to read it")
        if file.exists() and not file.is_file():
            raise RecordingError(f"'{file}' is no regular file")
    except (OSError, RuntimeError) as error:  # a name too long, or a loop of links
        reason = getattr(error, "strerror", None) or error  # the text of an OSError repeats the name
        raise RecordingError(f"'{file}' cannot be read: {reason}") from error
    return file

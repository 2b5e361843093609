"""Messages of a bag of somebody else, whatever it holds: read by rosbags, whose exceptions become RecordingError."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader

from ik_node.errors import IkNodeError, InputError, RecordingError
from ik_node.messages.cdr import STORE, serialize
from ik_node.recording.mcap.file import MAX_TIME_NS
from ik_node.recording.mcap.metadata import METADATA_FILE, ROOT
from ik_node.recording.mcap.reader import McapPart, Topic, inside
from ik_node.settings.yaml_text import bounded_text, load_yaml

_SUFFIXES = (".mcap", ".db3", ".bag")
_STORAGES = ("mcap", "sqlite3")
_KEYS = ("version", "duration", "starting_time", "message_count", "topics_with_message_count", "relative_file_paths")
"""Keys of ``metadata.yaml`` that rosbags needs."""


class BagReader:
    """The topics and messages of a bag."""

    def __init__(self, path: Path) -> None:
        """Opens a bag.

        Args:
            path: Folder or file. A folder without usable ``metadata.yaml`` may have one file.

        Raises:
            RecordingError: There is no bag, or it cannot be read; in one line, with what to do.
        """
        self.path = path
        with _as_recording_error(path):
            self._file = _bag_file(path)
            self._parts: list[McapPart] = []
            try:
                self.counts = self._rosbags_counts()
                """Topic -> number of messages."""
            except Exception as error:
                # rosbags reads no MCAP in which one topic has another encoding than CDR, such as JSON.
                self._parts = [McapPart(file) for file in _mcap_files(self._file)]
                if not self._parts or not _is_of_other_encoding(error):
                    raise
                self.counts = {}
                for part in self._parts:
                    for topic, count in part.counts().items():
                        self.counts[topic] = self.counts.get(topic, 0) + count

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, time in ns and CDR bytes of the messages of some topics, in the order of their times.

        Raises:
            RecordingError: The bag is damaged.
        """
        if not topics:
            return
        with _as_recording_error(self.path):
            for message in self._own_messages(topics) if self._parts else self._rosbags_messages(topics):
                if not 0 <= message[1] <= MAX_TIME_NS:
                    raise RecordingError(f"'{self.path}' has a message of topic {message[0]} at {message[1]} ns")
                yield message

    def _rosbags_counts(self) -> dict[Topic, int]:
        counts: dict[Topic, int] = {}
        with AnyReader([self._file], default_typestore=STORE) as reader:
            for connection in reader.connections:
                topic = Topic(connection.topic, connection.msgtype)
                counts[topic] = counts.get(topic, 0) + connection.msgcount
        return counts

    def _rosbags_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        with AnyReader([self._file], default_typestore=STORE) as reader:
            connections = [connection for connection in reader.connections if connection.topic in topics]
            if connections:
                for connection, time_ns, data in reader.messages(connections=connections):
                    cdr = bytes(data) if reader.is2 else _as_ros2(reader.deserialize(data, connection.msgtype))
                    yield connection.topic, time_ns, cdr

    def _own_messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        found = [
            (message.topic, message.log_time_ns, message.data)
            for part in self._parts
            for message in part.messages(topics)
        ]
        yield from sorted(found, key=lambda message: message[1])


@contextlib.contextmanager
def _as_recording_error(path: Path) -> Iterator[None]:
    """Whatever rosbags and the libraries below it raise for the content of a file, as RecordingError."""
    try:
        yield
    except IkNodeError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or "a length in it exceeds the memory"
        name = type(error).__name__
        told = reason if name.endswith("ReaderError") else f"{name}: {reason}"
        hint = _hint(path)
        raise RecordingError(f"'{path}' cannot be read as a bag: {told[:300]}{hint}") from error


def _hint(path: Path) -> str:
    with contextlib.suppress(OSError):
        folder = path if path.is_dir() else path.parent
        if any(folder.glob("*.db3-wal")):
            return (
                "; it was not closed (a .db3-wal lies beside it): sqlite3 FILE.db3 'PRAGMA wal_checkpoint' completes it"
            )
    return ""


def _bag_file(path: Path) -> Path:
    """What rosbags opens: the file, the folder, or the one file of a folder without usable ``metadata.yaml``."""
    if not path.is_dir():
        if not path.exists():
            raise RecordingError(f"'{path}' cannot be read as a bag: it does not exist")
        if not path.is_file():
            raise RecordingError(f"'{path}' cannot be read as a bag: it is no regular file")
        return path
    reason = _defect_of_metadata(path)
    if not reason:
        return path
    files = sorted(file for file in path.iterdir() if file.suffix in _SUFFIXES)
    if len(files) == 1:
        return inside(path, files[0].name)
    names = f"name one of its files ({', '.join(file.name for file in files[:5])})" if files else "it holds no bag file"
    raise RecordingError(f"'{path}' cannot be read as a bag: {reason}; use ros2 bag reindex, or {names}")


def _defect_of_metadata(directory: Path) -> str:
    """Why ``metadata.yaml`` cannot be used; empty when it can."""
    try:
        content = load_yaml(bounded_text(directory / METADATA_FILE))
    except FileNotFoundError:
        return f"it has no {METADATA_FILE}"
    except InputError as error:
        return f"{METADATA_FILE}: {error}"
    metadata = content.get(ROOT) if isinstance(content, dict) else None
    if not isinstance(metadata, dict):
        return f"{METADATA_FILE} has no mapping '{ROOT}'"
    missing = [key for key in _KEYS if key not in metadata]
    if missing:
        return f"{METADATA_FILE} lacks {', '.join(missing)}"
    return _defect_of_files(directory, metadata)


def _defect_of_files(directory: Path, metadata: dict[str, Any]) -> str:
    storage, names = metadata.get("storage_identifier"), metadata["relative_file_paths"]
    if storage not in _STORAGES:
        return f"{METADATA_FILE} has storage_identifier {storage!r}; valid: {', '.join(_STORAGES)}"
    if not isinstance(names, list) or not names:
        return f"{METADATA_FILE} has no list relative_file_paths"
    for name in names:
        # Until version 3 the names begin with the folder; rosbags takes what follows.
        inside(
            directory, name.rpartition("/")[2] if isinstance(name, str) and metadata["version"] in (1, 2, 3) else name
        )
    return ""


def _mcap_files(path: Path) -> list[Path]:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return [inside(file.parent, file.name) if path.is_dir() else file for file in files if file.suffix == ".mcap"]


def _is_of_other_encoding(error: Exception) -> bool:
    return isinstance(error, KeyError) or "Serialization format" in str(error)


def _as_ros2(message: Any) -> bytes:
    """CDR bytes of a ROS 1 message as the ROS 2 type of the same name, which may have fewer fields."""
    return serialize(_recast(message))


def _recast(message: Any) -> Any:
    target: Any = STORE.types[message.__msgtype__]
    fields = [entry.name for entry in dataclasses.fields(target)]
    return target(**{name: _recast_value(getattr(message, name)) for name in fields})


def _recast_value(value: Any) -> Any:
    if hasattr(value, "__msgtype__"):
        return _recast(value)
    return [_recast_value(entry) for entry in value] if isinstance(value, list) else value

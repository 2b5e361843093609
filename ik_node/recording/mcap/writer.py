"""Writes a rosbag2-style MCAP directory, by default in a separate thread.

The control loop calls :meth:`Recorder.write`, which packs and queues the message; it neither waits for the disk nor
raises. Every :attr:`RecorderOptions.flush_period_s` the thread writes the queued messages as one chunk, which limits
what a killed process loses. When the disk is too slow the queue fills, and further messages are counted and left out.
Without a thread (:attr:`RecorderOptions.own_thread`) the caller decides when the file is written, for programs that do
not run in real time and need reproducible chunks.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from rosbags.typesys import TypesysError

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS
from ik_node.recording.mcap.file import ChannelInfo, McapFile, PendingChunk
from ik_node.recording.mcap.metadata import (
    DROPPED,
    RECORD_NAME,
    PartInfo,
    Qos,
    bag_metadata,
    describe_topic,
    metadata_record,
    write_metadata,
)

LIBRARY = "ik_node"
MEGABYTE = 1_000_000
MAX_CHUNK_BYTES = 1 << 20
CLOSE_TIMEOUT_S = 20.0


class RecorderOptions(NamedTuple):
    """Options of a recording."""

    compression: str = "zstd"
    """A key of :data:`ik_node.recording.mcap.file.COMPRESSORS`."""
    flush_period_s: float = 0.1
    """Period at which queued messages are written to the file."""
    queue_mb: float = 32.0
    """Maximum size of the messages waiting for the disk."""
    max_part_mb: float = 0.0
    """Size at which a new file is due; 0: never."""
    max_part_s: float = 0.0
    """Duration at which a new file is due; 0: never."""
    own_thread: bool = True
    """False: the file is written only in :meth:`Recorder.write_pending` and :meth:`Recorder.close`."""


class _Latched(NamedTuple):
    """The last message of a latched topic."""

    sequence: int
    publish_time_ns: int
    data: bytes


@dataclass
class _Batch:
    """Unit of work of the thread: new topics, then messages."""

    topics: list[ChannelInfo] = field(default_factory=list)
    chunk: PendingChunk = field(default_factory=PendingChunk)
    data_size: int = 0
    begins_part: bool = False
    latched: dict[int, _Latched] = field(default_factory=dict)
    """At the start of a file: channel -> last message before it."""


class Recorder:
    """Writer of one recording."""

    def __init__(
        self, directory: Path, options: RecorderOptions | None = None, custom: Mapping[str, str] | None = None
    ) -> None:
        """Creates ``directory`` and its first file; ``custom`` goes to ``custom_data`` of ``metadata.yaml``.

        Raises RecordingError when the directory exists or cannot be made. Nothing is raised later: see :attr:`error`.
        """
        self.directory = directory
        self.options = options or RecorderOptions()
        self._custom = dict(custom or {})
        self._topics: list[ChannelInfo] = []
        self._known: list[ChannelInfo] = []
        self._latching: set[int] = set()
        self._latched: dict[int, _Latched] = {}
        self._lock = threading.Lock()
        self._filling = _Batch()
        self._full: deque[_Batch] = deque()
        self._taken: deque[_Batch] = deque()
        self._capacity = round(self.options.queue_mb * MEGABYTE)
        self._queued = 0
        self._dropped = 0
        self._error = ""
        self._split_due = False
        self._parts: list[PartInfo] = []
        self._closing = threading.Event()
        self._finished = False
        self._thread: threading.Thread | None = None
        try:
            directory.mkdir(parents=True, exist_ok=False)
            self._file = self._open_part()
        except FileExistsError as error:
            raise RecordingError(f"recording '{directory}' exists already; it is not overwritten") from error
        except OSError as error:
            raise RecordingError(f"recording '{directory}' cannot be made: {error.strerror}") from error
        if self.options.own_thread:
            self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()

    # --- called by the control loop ---

    def channel(self, topic: str, type_name: str, qos: Qos | None = None) -> int:
        """Registers a topic and returns its channel number; to be called once per topic, before its first message.

        Raises RecordingError when the type is not among ROS 2 Jazzy's common interfaces.
        """
        qos = qos or Qos()
        try:
            described = describe_topic(topic, type_name, qos)
        except TypesysError as error:
            raise RecordingError(f"topic '{topic}' has type '{type_name}', which cannot be recorded") from error
        with self._lock:
            self._topics.append(described)
            self._filling.topics.append(described)
            number = len(self._topics)
            if qos.latched:
                self._latching.add(number)
        return number

    def write(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int = 0, sequence: int = 0) -> bool:
        """Queues a message; returns False and counts it when it was left out.

        ``log_time_ns`` is when it was received or made, ``publish_time_ns`` when its source sent it (0: the same), both
        in ROS time. ``sequence`` is the source's running number.
        """
        log_time_ns = max(log_time_ns, 1)  # simulated time starts at 0, which readers interpret as no time
        publish_time_ns = publish_time_ns if publish_time_ns > 0 else log_time_ns
        size = len(data)
        with self._lock:
            if self._error or self._closing.is_set() or self._queued + size > self._capacity:
                self._dropped += 1
                return False
            chunk = self._filling.chunk
            chunk.add(channel, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns, data)
            self._queued += size
            self._filling.data_size += size
            if channel in self._latching:
                self._latched[channel] = _Latched(sequence, publish_time_ns, data)
            if chunk.size >= MAX_CHUNK_BYTES:
                self._full.append(self._filling)
                self._filling = _Batch()
        return True

    def split(self) -> None:
        """Starts a new file with the next message and repeats the last message of each latched topic in it."""
        with self._lock:
            self._split_due = False
            self._full.append(self._filling)
            self._filling = _Batch(begins_part=True, latched=dict(self._latched))

    def end(self) -> None:
        """Accepts no more messages and returns at once; the thread completes the files. See :attr:`ended`."""
        self._closing.set()

    def close(self) -> None:
        """As :meth:`end`, but waits for queued messages, index and ``metadata.yaml``; may be called repeatedly."""
        self.end()
        if self._thread is None:
            self._finish()
            return
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive() and not self._error:
            self._error = f"recording '{self.directory}' was not finished within {CLOSE_TIMEOUT_S:g} s"

    def write_pending(self) -> None:
        """Writes the queued messages as one or more chunks; no effect with a thread or after the end."""
        if self._thread is None:
            self._write_what_gathered()

    @property
    def dropped(self) -> int:
        """Number of messages left out so far."""
        return self._dropped

    @property
    def error(self) -> str:
        """Why writing ended early; empty for none. What was written before remains readable."""
        return self._error

    @property
    def ended(self) -> bool:
        """True when the files are complete or writing has failed."""
        return self._finished if self._thread is None else not self._thread.is_alive()

    @property
    def split_due(self) -> bool:
        """True when a file has reached its size or duration, so that :meth:`split` should be called."""
        return self._split_due

    # --- called by the thread, or by the caller without a thread ---

    def _run(self) -> None:
        while not (self._closing.wait(self.options.flush_period_s) or self._finished):
            self._write_what_gathered()
        self._finish()

    def _write_what_gathered(self) -> None:
        if not self._finished:
            with self._giving_up_on_errors():
                self._write_queued()

    def _finish(self) -> None:
        """Completes the files, unless that was done or has failed."""
        if not self._finished:
            with self._giving_up_on_errors():
                self._write_queued()
                self._finish_part()
                self._write_metadata()
            self._finished = True

    @contextlib.contextmanager
    def _giving_up_on_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._give_up(f"recording '{self.directory}' has ended: {error.strerror}")
        except Exception as error:  # a defect is reported, and the queue does not grow without bound
            self._give_up(f"recording '{self.directory}' has ended: {type(error).__name__}: {error}")

    def _write_queued(self) -> None:
        with self._lock:
            self._taken.extend((*self._full, self._filling))
            self._full.clear()
            self._filling = _Batch()
        while self._taken:
            self._write_batch(self._taken[0])
            with self._lock:
                self._queued -= self._taken.popleft().data_size
        limit_mb, limit_s = self.options.max_part_mb, self.options.max_part_s
        content = self._file.content
        too_big = 0.0 < limit_mb * MEGABYTE <= self._file.size
        too_long = 0.0 < limit_s * NS <= content.end_ns - content.start_ns
        with self._lock:
            if (too_big or too_long) and not any(batch.begins_part for batch in (*self._full, self._filling)):
                self._split_due = True

    def _write_batch(self, batch: _Batch) -> None:
        if batch.begins_part:
            self._finish_part()
            self._file = self._open_part()
            if batch.chunk.count:
                self._file.add_chunk(_repeated(batch.latched, batch.chunk.span()[0]))
        for topic in batch.topics:
            self._known.append(topic)
            self._file.add_channel(topic)
        self._file.add_chunk(batch.chunk)

    def _open_part(self) -> McapFile:
        name = f"{self.directory.name}_{len(self._parts)}.mcap"
        part = McapFile.create(self.directory / name, LIBRARY, self.options.compression)
        for topic in self._known:
            part.add_channel(topic)
        part.add_metadata(RECORD_NAME, metadata_record(self._metadata([PartInfo(name, part.content)])))
        return part

    def _finish_part(self) -> None:
        part = PartInfo(self._file.path.name, self._file.content)
        self._file.add_metadata(RECORD_NAME, metadata_record(self._metadata([part])))
        self._file.finish()
        self._parts.append(part)

    def _write_metadata(self) -> None:
        write_metadata(self.directory, self._metadata(self._parts))

    def _metadata(self, parts: list[PartInfo]) -> dict[str, object]:
        return bag_metadata(parts, {**self._custom, DROPPED: str(self._dropped)})

    def _give_up(self, reason: str) -> None:
        """Ends the recording after an error; completes the files if the disk permits."""
        self._finished = True
        with self._lock:
            self._error = reason
            self._dropped += sum(batch.chunk.count for batch in (*self._taken, *self._full, self._filling))
            self._full.clear()
            self._filling = _Batch()
        with contextlib.suppress(OSError):
            self._finish_part()
            self._write_metadata()
        with contextlib.suppress(OSError):
            self._file.abandon()


def _repeated(latched: Mapping[int, _Latched], log_time_ns: int) -> PendingChunk:
    """A chunk with the last message of each latched topic."""
    chunk = PendingChunk()
    for channel, message in latched.items():
        chunk.add(channel, message.sequence, log_time_ns, message.publish_time_ns, message.data)
    return chunk

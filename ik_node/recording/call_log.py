"""A recording as a sequence of controller calls with their messages and the resulting Steps.

Nothing here constructs a controller or a robot: messages, settings and snapshots are returned as recorded, and
:mod:`ik_node.replay.call_source` makes a controller of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from ik_node.errors import InputError, RecordingError
from ik_node.messages.decode import decode_string
from ik_node.messages.parameters import decode_parameters
from ik_node.messages.step_codec import STEP_TYPE, Call, CallKind, StepDecoder, decode_call
from ik_node.recording.input_table import INPUTS, TEXT_CALLS
from ik_node.recording.json_codec import from_json
from ik_node.recording.mcap.metadata import DROPPED, REPAIRED
from ik_node.recording.mcap.reader import RecordedMessage, Recording, Topic
from ik_node.recording.run_recorder import (
    CALL_TEXTS,
    CALLS,
    FORMAT,
    PARAMETERS,
    ROBOT_DESCRIPTION,
    SETUP,
    SNAPSHOT,
    STEP,
    STEP_TEXTS,
)
from ik_node.settings.groups import Settings

_ARGUMENT_SOURCES: Mapping[CallKind, str] = {
    **{kind: entry.name for kind, entry in INPUTS.items()},
    **dict.fromkeys(TEXT_CALLS, CALL_TEXTS),
    CallKind.APPLY: PARAMETERS,
}
"""Input or topic of the message that a call took; other calls have no argument."""
_PendingCall = tuple[int, Call, bytes]
"""The entries of a :class:`RecordedCall` without its Step."""
T = TypeVar("T")


class RecordedCall(NamedTuple):
    """One controller call of a recording."""

    number: int
    """Counts all calls of the run; a gap means that calls are missing."""
    call: Call
    data: bytes
    """Message with the argument: input, text or parameters; empty for none."""
    step: bytes | None
    """Message of the Step that the call returned."""


class RecordedSnapshot(NamedTuple):
    """State of the controller at this position of a recording."""

    text: str
    """JSON; see :func:`decode_snapshot`."""


class RunHead(NamedTuple):
    """What a recording contains before its first call."""

    node: str
    setup: Mapping[str, Any]
    urdf: str
    settings: Settings
    snapshot: str | None
    """State of the controller at the start as JSON; None when it had not been called."""


class _Arguments:
    """Messages of one source that no call has taken yet, by number or by time of recording."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[bytes]] = {}

    def add(self, key: int, data: bytes) -> None:
        self._waiting.setdefault(key, []).append(data)

    def take(self, key: int) -> bytes | None:
        """The first message of a number or time, which is not kept; None when there is none."""
        found = self._waiting.get(key)
        if found is None:
            return None
        if len(found) == 1:
            del self._waiting[key]
        return found.pop(0)


class RecordedCalls:
    """The controller calls of one node in a recording, complete or cut off."""

    def __init__(self, path: str | Path, node: str = "") -> None:
        """Opens a recording.

        Args:
            path: Folder, or one of its files.
            node: Full name of the node; default: the only one in the recording.

        Raises:
            RecordingError: There is no recording, it is damaged, or it holds no run of that node; the message lists
                what it does hold.
        """
        self.recording, name = open_recording(Path(path), node)
        self.path = Path(path)
        self.steps = StepDecoder()
        """Decodes the Steps of calls that :meth:`entries` has returned."""
        own = (SETUP, PARAMETERS, SNAPSHOT, CALLS, CALL_TEXTS, STEP, STEP_TEXTS)
        self._roles = {f"{name}/{role}": role for role in own} | {ROBOT_DESCRIPTION: ROBOT_DESCRIPTION}
        self.head = self._read_head(name)
        self._inputs = {topic: entry for entry, topic in self.head.setup["inputs"].items()}

    @property
    def initial_settings(self) -> Settings:
        """Settings at the start."""
        return self.head.settings

    def entries(self) -> Iterator[RecordedCall | RecordedSnapshot]:
        """All calls and snapshots in recorded order; raises RecordingError where the recording is damaged."""
        waiting: dict[str, _Arguments] = {
            source: _Arguments() for source in {*self._inputs.values(), *_ARGUMENT_SOURCES.values()}
        }
        inputs = {topic: waiting[source] for topic, source in self._inputs.items()}
        pending: _PendingCall | None = None
        step: bytes | None = None
        is_numbered = self._is_numbered()
        calls = 0
        for message in self.recording.messages({*self._roles, *self._inputs}):
            topic, _, data, log_time_ns, _, number = message
            role = self._roles.get(topic)
            if role is None:
                inputs[topic].add(number if is_numbered else log_time_ns, data)
            elif role == STEP:
                step = data
            elif role == CALLS:
                if pending is not None:
                    yield RecordedCall(*pending, step)
                pending = self._pending_call(message, waiting, message.sequence if is_numbered else calls, is_numbered)
                step = None
                calls += 1
            elif role == STEP_TEXTS:
                self._decoded(message, self.steps.texts)
            elif role in (CALL_TEXTS, PARAMETERS):
                waiting[role].add(number if is_numbered else log_time_ns, data)
            elif role == SNAPSHOT:
                if pending is not None:
                    yield RecordedCall(*pending, step)
                    pending = None
                yield RecordedSnapshot(self._decoded(message, decode_string))
        if pending is not None:
            yield RecordedCall(*pending, step)

    @property
    def lossy(self) -> bool:
        """True when messages are missing: cut off, repaired, or left out by the writer."""
        custom = self.recording.custom
        return not self.recording.complete or custom.get(DROPPED, "0") != "0" or REPAIRED in custom

    def settings(self, recorded: RecordedCall) -> Settings:
        """All settings after a call of kind ``APPLY``."""
        return self.head.settings.with_values(decode_parameters(recorded.data).values)

    def _is_numbered(self) -> bool:
        """False when the messages have lost their sequence numbers: rosbag2 writes 0 for each (ros2 bag convert)."""
        topics = {topic for topic, role in self._roles.items() if role == CALLS}
        numbers = [message.sequence for message in islice(self.recording.messages(topics), 2)]
        return numbers != [0, 0]

    def _pending_call(
        self, message: RecordedMessage, waiting: dict[str, _Arguments], number: int, is_numbered: bool
    ) -> _PendingCall | None:
        """The call with its argument; None when the argument is missing.

        Without sequence numbers the argument is the first message with the time of recording of the call.
        """
        call: Call = self._decoded(message, decode_call)
        source = _ARGUMENT_SOURCES.get(call.kind)
        if source is None:
            return number, call, b""
        data = waiting[source].take(call.sequence if is_numbered else message.log_time_ns)
        return None if data is None else (number, call, data)

    def _read_head(self, node: str) -> RunHead:
        found: dict[str, RecordedMessage] = {}
        for message in self.recording.messages(self._roles):
            role = self._roles[message.topic]
            if role in (CALLS, STEP):
                break
            found[role] = message
        missing = [role for role in (ROBOT_DESCRIPTION, SETUP, PARAMETERS) if role not in found]
        if missing:
            raise RecordingError(f"'{self.path}' lacks the start of the run of node '{node}': {', '.join(missing)}")
        parameters = self._decoded(found[PARAMETERS], decode_parameters).values
        return RunHead(
            node,
            read_setup(self._decoded(found[SETUP], decode_string)),
            self._decoded(found[ROBOT_DESCRIPTION], decode_string),
            Settings().with_values(parameters),
            self._decoded(found[SNAPSHOT], decode_string) if SNAPSHOT in found else None,
        )

    def _decoded(self, message: RecordedMessage, decode: Callable[[bytes], T]) -> T:
        try:
            return decode(message.data)
        except InputError as error:
            raise RecordingError(f"'{self.path}', topic {message.topic}: {error}") from error


def decode_snapshot(text: str, kind: type[T]) -> T:
    """Decodes a controller snapshot.

    Args:
        text: JSON of the topic ``snapshot``.
        kind: Type of the snapshot: :class:`ik_node.control.controller_state.ControllerSnapshot`.

    Raises:
        RecordingError: The fields are those of another version of ik_node.
    """
    try:
        snapshot: T = from_json(text, kind)
    except InputError as error:
        raise RecordingError(f"the controller snapshot is that of another version of ik_node: {error}") from error
    return snapshot


def open_recording(path: Path, node: str = "") -> tuple[Recording, str]:
    """Opens a recording, and finds the node.

    Args:
        path: Folder, or one of its files.
        node: Full name of the node; default: the only recorded one.

    Raises:
        RecordingError: As :func:`find_node`; or there is no recording, or it is a bag of another program.
    """
    try:
        recording = Recording(path)
    except RecordingError as error:
        if held := _topics_of_other_bag(path):
            raise _no_run(path, held) from error
        raise
    return recording, find_node(recording, node)


def _topics_of_other_bag(path: Path) -> str:
    """The topics of a bag without a run; empty for anything else."""
    try:
        from ik_node.recording.bag_reader import BagReader

        counts = BagReader(path).counts
    except (RecordingError, ImportError):  # no bag, or rosbags is not installed
        return ""
    return "" if any(topic.name.endswith(f"/{STEP}") for topic in counts) else content_text(counts)


def find_node(recording: Recording, node: str = "") -> str:
    """The full name of ``node``, or of the only recorded one by default; raises RecordingError listing the nodes."""
    counts = recording.counts()
    ending = f"/{STEP}"
    nodes = [topic.name[: -len(ending)] for topic in counts if topic.name.endswith(ending) and topic[1] == STEP_TYPE]
    node = node.rstrip("/")
    if node in nodes or (len(nodes) == 1 and not node):
        return node or nodes[0]
    if nodes:
        which = f"no run of node '{node}'" if node else "several runs; name a node"
        raise RecordingError(f"'{recording.path}' holds {which}; valid: {', '.join(sorted(nodes))}")
    raise _no_run(recording.path, content_text(recording.counts()))


def _no_run(path: Path, held: str) -> RecordingError:
    return RecordingError(f"'{path}' holds no run of ik_node; it holds: {held}")


def content_text(counts: Mapping[Topic, int]) -> str:
    """Topics with types and counts, for error messages."""
    return ", ".join(f"{topic.name} ({topic.type_name}, {count})" for topic, count in counts.items()) or "nothing"


class _SetupTypes(NamedTuple):
    """The entries of a setup that are read, with their types."""

    robot: str
    base_frame: str
    tip_frame: str
    joints: tuple[str, ...]
    limits: Mapping[str, tuple[float | None, ...]]
    inputs: Mapping[str, str]
    geometry: str
    versions: Mapping[str, str]
    methods: Mapping[str, str] = MappingProxyType({})


def read_setup(text: str) -> dict[str, Any]:
    """The content of the topic ``setup``; raises RecordingError for other content or another format."""
    try:
        setup: dict[str, Any] = json.loads(text)
        version = setup["format"]
        if version == FORMAT:
            limits = from_json(text, _SetupTypes).limits
            setup.setdefault("methods", {})  # of a recording without own methods
            wrong = [name for name in ("lower", "upper", "velocity") if len(limits[name]) != len(setup["joints"])]
            if wrong:
                raise InputError(f"limits {', '.join(wrong)} for another number of joints than {len(setup['joints'])}")
    except (ValueError, LookupError, TypeError, RecursionError) as error:
        raise RecordingError(f"the setup of a run cannot be read: {error}") from error
    if version != FORMAT:
        raise RecordingError(f"recorded in format {version}; this version of ik_node reads {FORMAT}")
    return setup

"""A recording as what happened to the controller: its calls in their order, and the Steps that came of them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from ik_node.control.controller import Controller
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import InputError, RecordingError
from ik_node.messages.decode import decode_string
from ik_node.messages.parameters import decode_parameters
from ik_node.messages.step_codec import STEP_TYPE, Call, CallKind, StepDecoder, decode_call
from ik_node.recording.input_table import INPUTS, SETTINGS_CALLS, TEXT_CALLS
from ik_node.recording.json_codec import from_json
from ik_node.recording.mcap.metadata import DROPPED, REPAIRED
from ik_node.recording.mcap.reader import RecordedMessage, Recording
from ik_node.recording.run_recorder import (
    CALL_TEXTS,
    CALLS,
    FORMAT,
    PARAMETERS,
    ROBOT_DESCRIPTION,
    SETUP,
    STATE,
    STEP,
    STEP_TEXTS,
)
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

_SOURCES: Mapping[CallKind, str] = {
    **{kind: entry.name for kind, entry in INPUTS.items()},
    **dict.fromkeys(TEXT_CALLS, CALL_TEXTS),
    **dict.fromkeys(SETTINGS_CALLS, PARAMETERS),
}
"""Where the message that a call took is found; the others take none."""
_Pending = tuple[int, Call, bytes]
"""An event but for its step."""


class Event(NamedTuple):
    """One call of the controller."""

    number: int
    """Counts all calls of a recording; one that is left out was lost."""
    call: Call
    data: bytes
    """The message that the call took, with the text or the parameters; empty where it took none."""
    step: bytes | None
    """The message ``step`` that came of it."""


class Checkpoint(NamedTuple):
    """What the controller remembered at this point of a recording."""

    state: ControllerSnapshot


class Head(NamedTuple):
    """What a recording says of its run before the first call."""

    node: str
    setup: Mapping[str, Any]
    urdf: str
    settings: Settings
    state: ControllerSnapshot | None
    """Where the run begins; None: with a controller that has not been called yet."""


class RecordedCalls:
    """The calls of one node in a recording, whole or cut off."""

    def __init__(self, path: str | Path, node: str = "") -> None:
        """``node``: full name; default: the only one there is.

        Raises RecordingError when there is no recording, when it is damaged, or when it holds no run of that node; the
        message says what it does hold.
        """
        self.recording = Recording(Path(path))
        self.path = Path(path)
        self.steps = StepDecoder()
        """Understands the Steps of events that :meth:`events` has handed out."""
        name = find_node(self.recording, node)
        own = (SETUP, PARAMETERS, STATE, CALLS, CALL_TEXTS, STEP, STEP_TEXTS)
        self._roles = {f"{name}/{role}": role for role in own} | {ROBOT_DESCRIPTION: ROBOT_DESCRIPTION}
        self.head = self._read_head(name)
        self._inputs = {topic: entry for entry, topic in self.head.setup["inputs"].items()}

    @property
    def begins_with(self) -> Settings:
        """Settings at the start."""
        return self.head.settings

    def robot(self) -> Robot:
        """The robot of the run, a new one at every call; RobotError when its URDF cannot be read."""
        setup, prefix = self.head.setup, self.head.settings.arm.joint_prefix
        return Robot(self.head.urdf, setup["base_frame"], setup["tip_frame"], tuple(setup["joints"]), prefix)

    def controller(self, settings: Settings | None = None) -> Controller:
        """A controller that is where the recorded one was when the recording began; with other ``settings`` maybe."""
        settings = settings or self.head.settings
        if self.head.state is not None:  # which holds the obstacles; the file that they came from may be elsewhere
            settings = settings.with_values({"obstacles.scene": ""})
        controller = Controller(self.robot(), settings)
        if self.head.state is not None:
            controller.restore(self.head.state)
        return controller

    def events(self) -> Iterator[Event | Checkpoint]:
        """Everything in its order. RecordingError where the recording is damaged."""
        waiting: dict[str, dict[int, bytes]] = {source: {} for source in {*self._inputs.values(), *_SOURCES.values()}}
        inputs = {topic: waiting[source] for topic, source in self._inputs.items()}
        pending: _Pending | None = None
        step: bytes | None = None
        for message in self.recording.messages({*self._roles, *self._inputs}):
            topic, _, data, _, _, number = message
            role = self._roles.get(topic)
            if role is None:
                inputs[topic][number] = data
            elif role == STEP:
                step = data
            elif role == CALLS:
                if pending is not None:
                    yield Event(*pending, step)
                pending, step = self._called(message, waiting), None
            elif role == STEP_TEXTS:
                self._understood(message, self.steps.texts)
            elif role in (CALL_TEXTS, PARAMETERS):
                waiting[role][number] = data
            elif role == STATE:
                if pending is not None:
                    yield Event(*pending, step)
                    pending = None
                yield Checkpoint(self._understood(message, decode_state))
        if pending is not None:
            yield Event(*pending, step)

    @property
    def lossy(self) -> bool:
        """True where the recording says, or shows, that it does not hold everything."""
        custom = self.recording.custom
        return not self.recording.complete or custom.get(DROPPED, "0") != "0" or REPAIRED in custom

    def settings(self, event: Event) -> Settings:
        """All settings after a call that changed them."""
        return self.head.settings.with_values(decode_parameters(event.data).values)

    def _called(self, message: RecordedMessage, waiting: dict[str, dict[int, bytes]]) -> _Pending | None:
        """The call with what it took; None where that was lost."""
        call: Call = self._understood(message, decode_call)
        source = _SOURCES.get(call.kind)
        if source is None:
            return message.sequence, call, b""
        data = waiting[source].pop(call.sequence, None)
        return None if data is None else (message.sequence, call, data)

    def _read_head(self, node: str) -> Head:
        found: dict[str, RecordedMessage] = {}
        for message in self.recording.messages(self._roles):
            role = self._roles[message.topic]
            if role in (CALLS, STEP):
                break
            found[role] = message
        missing = [role for role in (ROBOT_DESCRIPTION, SETUP, PARAMETERS) if role not in found]
        if missing:
            raise RecordingError(f"'{self.path}' lacks the beginning of the run of node '{node}': {', '.join(missing)}")
        parameters = self._understood(found[PARAMETERS], decode_parameters).values
        return Head(
            node,
            read_setup(self._understood(found[SETUP], decode_string)),
            self._understood(found[ROBOT_DESCRIPTION], decode_string),
            Settings().with_values(parameters),
            self._understood(found[STATE], decode_state) if STATE in found else None,
        )

    def _understood(self, message: RecordedMessage, decode: Any) -> Any:
        try:
            return decode(message.data)
        except InputError as error:
            raise RecordingError(f"'{self.path}', topic {message.topic}: {error}") from error


def decode_state(data: bytes) -> ControllerSnapshot:
    """The state in a message of the topic ``state``; InputError when it holds none."""
    try:
        state: ControllerSnapshot = from_json(decode_string(data), ControllerSnapshot)
    except InputError as error:
        raise InputError(f"the controller's memory in it is that of another version of ik_node: {error}") from error
    return state


def find_node(recording: Recording, wanted: str = "") -> str:
    """The node whose run is asked for, by default the only one; RecordingError with what there is instead."""
    counts = recording.counts()
    ending = f"/{STEP}"
    nodes = [topic.name[: -len(ending)] for topic in counts if topic.name.endswith(ending) and topic[1] == STEP_TYPE]
    wanted = wanted.rstrip("/")
    if wanted in nodes or (len(nodes) == 1 and not wanted):
        return wanted or nodes[0]
    if nodes:
        which = f"no run of node '{wanted}'" if wanted else "several runs; name a node"
        raise RecordingError(f"'{recording.path}' holds {which}; valid: {', '.join(sorted(nodes))}")
    raise RecordingError(f"'{recording.path}' holds no run of ik_node; it holds: {what_it_holds(recording)}")


def what_it_holds(recording: Recording) -> str:
    """Topics with types and counts, for people."""
    counts = recording.counts().items()
    return ", ".join(f"{topic.name} ({topic.type_name}, {count})" for topic, count in counts) or "nothing"


def read_setup(text: str) -> dict[str, Any]:
    """What the topic ``setup`` says; RecordingError when it is none, or of another format."""
    try:
        setup: dict[str, Any] = json.loads(text)
        version = setup["format"]
    except (ValueError, KeyError, TypeError) as error:
        raise RecordingError(f"the setup of a run cannot be read: {error}") from error
    if version != FORMAT:
        raise RecordingError(f"recorded in format {version}; this version of ik_node reads {FORMAT}")
    return setup

"""Where the calls of a replay come from, and how they are made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from ik_node.control.controller import Controller
from ik_node.errors import IkNodeError
from ik_node.interfaces.step import Step
from ik_node.messages.decode import decode_string
from ik_node.recording.call_log import Checkpoint, Event
from ik_node.recording.input_table import BARE_CALLS, INPUTS, SETTINGS_CALLS, TEXT_CALLS
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings, Value


class Source(Protocol):
    """A recording of ours (:class:`ik_node.recording.call_log.RecordedCalls`) or a foreign bag."""

    @property
    def begins_with(self) -> Settings:
        """Settings at the start."""

    def robot(self) -> Robot:
        """The robot of the run, a new one at every call."""

    def controller(self, settings: Settings | None = None) -> Controller:
        """A new controller where the run begins, with the settings of the start or others."""

    def events(self) -> Iterator[Event | Checkpoint]:
        """The calls in their order."""

    def settings(self, event: Event) -> Settings:
        """All settings after a call that changed them."""


def calls(source: Source) -> Iterator[Event]:
    """The calls alone."""
    return (entry for entry in source.events() if isinstance(entry, Event))


def make(
    controller: Controller, source: Source, event: Event, changes: Mapping[str, Value] | None = None
) -> Step | None:
    """Makes a call as it is recorded; ``changes`` stay in force when it changes parameters."""
    (kind, _, now), data = event.call, event.data
    try:
        entry = INPUTS.get(kind)
        if entry is not None:
            return entry.make(controller, entry.decode(data), now)
        if kind in TEXT_CALLS:
            return TEXT_CALLS[kind](controller, decode_string(data), now)
        if kind in SETTINGS_CALLS:
            settings = source.settings(event).with_values(changes or {})
            return SETTINGS_CALLS[kind](controller, settings, now)
        return BARE_CALLS[kind](controller, now)
    except IkNodeError:  # refused, as it was then
        return None

"""The controller's words for what it is doing: steady enough to be read, prompt enough to be believed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Level, Mode, Status

RELEASE_S = 0.25
"""A condition is still mentioned this long after it last held, so that one that flickers does not flood the topic."""
_RELEASE_NS = round(RELEASE_S * NS)

CLOSED_LOOP = (Mode.HOLDING, Mode.TRACKING)
"""Modes in which a control law is at work."""


class StatusSnapshot(NamedTuple):
    """What a :class:`StatusKeeper` remembers."""

    status: Status
    notes: Mapping[str, str]
    until: Mapping[str, int]
    """Condition -> monotonic time until which it is mentioned; in the order in which they came up."""


class StatusKeeper:
    """Combines a mode with passing conditions into one status."""

    def __init__(self, status: Status) -> None:
        self.status = status
        self._notes: dict[str, str] = {}
        self._until: dict[str, int] = {}

    def note(self, subject: str, text: str = "") -> None:
        """A remark on a subject, that stays until there is another one on it; empty for none."""
        self._notes.pop(subject, None)
        if text:
            self._notes[subject] = text

    def flag(self, condition: str, holds: bool, now: Instant) -> None:
        """Says whether ``condition`` holds now; it is dropped ``RELEASE_S`` after it last held."""
        if holds:
            self.mention((condition,), now)
        elif self._until:
            self._drop(now)

    def mention(self, conditions: Iterable[str], now: Instant) -> None:
        """Takes the conditions that hold now, and drops those that were over ``RELEASE_S`` ago."""
        if self._until:
            self._drop(now)
        for condition in conditions:
            self._until[condition] = now.monotonic_ns + _RELEASE_NS

    def _drop(self, now: Instant) -> None:
        for over in [name for name, until_ns in self._until.items() if now.monotonic_ns >= until_ns]:
            del self._until[over]

    def set(self, base: Status) -> None:
        """States the mode and its reason; what is added to it makes it a warning.

        Remarks always are, conditions only while a control law is at work: a stopped arm is not slowed down.
        """
        passing = self._until if base.mode in CLOSED_LOOP else ()
        remarks = [*passing, *self._notes.values()]
        if remarks:
            level = base.level if base.level is Level.ERROR else Level.WARN
            self.status = Status(level, base.mode, "; ".join((base.reason, *remarks)))
        else:
            self.status = base

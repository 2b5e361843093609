"""Status of the controller: mode, reason, notes and transient conditions combined into one text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import CLOSED_LOOP, Level, Status

RELEASE_S = 0.25
"""A condition is reported for this time after it last held, so that one that flickers does not flood the topic."""
_RELEASE_NS = round(RELEASE_S * NS)

REACH = "reach"
"""Subject of the note on a target out of reach."""

DIRECTION = "direction"
"""Subject of the note on motion off the direction of the twist."""

ON_MOTION = (REACH, DIRECTION)
"""Subjects of notes that concern the present motion, and are only added in the modes of :data:`CLOSED_LOOP`."""


class StatusSnapshot(NamedTuple):
    """Attributes of a :class:`StatusReporter`."""

    status: Status
    notes: Mapping[str, str]
    until: Mapping[str, int]
    """Condition -> monotonic time until which it is reported, in the order of occurrence."""


class StatusReporter:
    """Combines a mode with notes and transient conditions into one status."""

    def __init__(self, status: Status) -> None:
        self.status = status
        self._notes: dict[str, str] = {}
        self._until: dict[str, int] = {}

    def note(self, subject: str, text: str = "") -> None:
        """Sets the note on a subject, which stays until the next call for this subject; an empty text removes it."""
        self._notes.pop(subject, None)
        if text:
            self._notes[subject] = text

    def set_condition(self, condition: str, holds: bool, now: Instant) -> None:
        """Reports one condition if it holds now; it is dropped ``RELEASE_S`` after it last held."""
        if holds:
            self.set_conditions((condition,), now)
        elif self._until:
            self._drop_expired(now)

    def set_conditions(self, conditions: Iterable[str], now: Instant) -> None:
        """Reports the conditions that hold now, and drops those that last held more than ``RELEASE_S`` ago."""
        if self._until:
            self._drop_expired(now)
        for condition in conditions:
            self._until[condition] = now.monotonic_ns + _RELEASE_NS

    def _drop_expired(self, now: Instant) -> None:
        for expired in [name for name, until_ns in self._until.items() if now.monotonic_ns >= until_ns]:
            del self._until[expired]

    def set(self, base: Status) -> None:
        """Sets mode and reason. Added texts raise the level to a warning.

        Notes are always added, except those of :data:`ON_MOTION`; they and conditions are added only while the control
        law computes the commands.
        """
        active = base.mode in CLOSED_LOOP
        notes = (text for subject, text in self._notes.items() if active or subject not in ON_MOTION)
        texts = [*(self._until if active else ()), *notes]
        if texts:
            level = base.level if base.level is Level.ERROR else Level.WARN
            self.status = Status(level, base.mode, "; ".join((base.reason, *texts)))
        else:
            self.status = base

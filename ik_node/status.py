"""The controller's words for what it is doing: steady enough to be read, prompt enough to be believed."""

from __future__ import annotations

from ik_node.clock import NS, Instant
from ik_node.step import Level, Status

RELEASE_S = 0.25
"""A condition is still mentioned this long after it last held, so that one that flickers does not flood the topic."""


class StatusKeeper:
    """Combines a mode with passing conditions into one status."""

    def __init__(self, status: Status) -> None:
        self.status = status
        self._note = ""
        self._until: dict[str, int] = {}

    def note(self, text: str) -> None:
        """A remark that stays until it is replaced; empty for none."""
        self._note = text

    def flag(self, condition: str, holds: bool, now: Instant) -> None:
        """Says whether ``condition`` holds now; it is dropped ``RELEASE_S`` after it last held."""
        if holds:
            self._until[condition] = now.monotonic_ns + round(RELEASE_S * NS)
        elif condition in self._until and now.monotonic_ns >= self._until[condition]:
            del self._until[condition]

    def set(self, base: Status) -> None:
        """States the mode and its reason; conditions and remark are added, and make it a warning."""
        remarks = [*self._until, *([self._note] if self._note else [])]
        if remarks:
            level = base.level if base.level is Level.ERROR else Level.WARN
            self.status = Status(level, base.mode, "; ".join((base.reason, *remarks)))
        else:
            self.status = base

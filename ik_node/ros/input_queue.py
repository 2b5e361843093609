"""Queue for inputs whose processing takes milliseconds, so that a flood of them leaves time for control steps."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

from ik_node.messages.step_codec import CallKind

DEPTH = 10
"""Messages that wait; as many as DDS keeps. Of more the oldest is skipped (keep last)."""
SHARE = 4.0
"""After a message this multiple of its processing time is left to everything else: at most a fifth of the time goes
into these inputs."""
REPLACED = (CallKind.ON_TARGET_PATH, CallKind.ON_TARGET_TRAJECTORY)
"""Inputs of which only the newest message matters."""


class InputQueue:
    """Passes messages on in order: at once when there was time since the last one, else at a later :meth:`run`."""

    def __init__(
        self, handle: Callable[[CallKind, bytes], None], clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        """``handle`` processes a message; ``clock_s`` returns a monotonic time, s."""
        self._handle = handle
        self._clock_s = clock_s
        self._waiting: deque[tuple[CallKind, bytes]] = deque()
        self._next_s = 0.0
        self._skipped: dict[CallKind, int] = {}

    def put(self, kind: CallKind, data: bytes) -> None:
        """Adds a message and processes the first one if it is due."""
        if kind in REPLACED:
            self._waiting = deque(entry for entry in self._waiting if entry[0] is not kind)
        elif len(self._waiting) >= DEPTH:
            oldest, _ = self._waiting.popleft()
            self._skipped[oldest] = self._skipped.get(oldest, 0) + 1
        self._waiting.append((kind, data))
        self.run()

    def run(self) -> None:
        """Processes the first message if it is due; to be called every few milliseconds."""
        start_s = self._clock_s()
        if not self._waiting or start_s < self._next_s:
            return
        kind, data = self._waiting.popleft()
        try:
            self._handle(kind, data)
        finally:
            end_s = self._clock_s()
            self._next_s = end_s + SHARE * (end_s - start_s)

    def clear(self) -> None:
        """Forgets all waiting messages."""
        self._waiting.clear()

    def take_skipped(self) -> dict[CallKind, int]:
        """Number of messages skipped since the last call, per input."""
        skipped, self._skipped = self._skipped, {}
        return skipped

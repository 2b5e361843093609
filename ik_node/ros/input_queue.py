"""Queue of inputs: a flood of them leaves time for control steps, requests and the detection of missing joint states.

The executor calls back in the order of arrival, so that messages that arrive faster than they are processed delay
everything behind them more and more. Therefore:

* Streamed inputs are processed at once. When the clock timer is overdue the node is behind: then messages are only
  taken over, which is fast, until the timer has been called, and the newest of them are processed then.
* Inputs whose processing takes milliseconds (obstacles, paths, trajectories) get a limited share of the time.
"""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Callable

from ik_node.interfaces.delivery import CLOCK_PERIOD_S
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import INPUTS

DEPTH = 10
"""Messages that wait: of each streamed input, and of all others. As many as DDS keeps; of more the oldest is skipped
(keep last)."""
SHARE = 4.0
"""After a message this multiple of its processing time is left to everything else: at most a fifth of the time goes
into inputs that are not streamed."""
OVERDUE_S = 0.01
"""Delay of :meth:`InputQueue.run` beyond which the node is behind. Events wait about twice as long at most, a fraction
of the 50 ms within which requests are answered; a shorter one would be exceeded by two long control steps."""
REPLACED = (CallKind.ON_TARGET_PATH, CallKind.ON_TARGET_TRAJECTORY)
"""Inputs of which only the newest message matters."""


class InputQueue:
    """Passes messages on in order: at once when there is time, else at a later :meth:`run`."""

    def __init__(
        self, handle: Callable[[CallKind, bytes], None], clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        """``handle`` processes a message; ``clock_s`` returns a monotonic time, s."""
        self._handle = handle
        self._clock_s = clock_s
        self._streamed: deque[tuple[CallKind, bytes]] = deque()
        self._waiting: deque[tuple[CallKind, bytes]] = deque()
        self._next_s = 0.0
        self._overdue_s = math.inf
        self._skipped: Counter[CallKind] = Counter()

    @property
    def behind(self) -> bool:
        """True when :meth:`run` is overdue: events arrive faster than they are processed, or the node was held up."""
        return self._clock_s() > self._overdue_s

    def put(self, kind: CallKind, data: bytes) -> None:
        """Adds a message and processes the first one if it is due."""
        if INPUTS[kind].streamed:
            self._put_streamed(kind, data)
            return
        if kind in REPLACED:
            self._waiting = deque(entry for entry in self._waiting if entry[0] is not kind)
        elif len(self._waiting) >= DEPTH:
            self._skipped[self._waiting.popleft()[0]] += 1
        self._waiting.append((kind, data))
        if not self.behind:
            self._process_waiting()

    def run(self) -> None:
        """Processes the messages that are due, for one period at most; to be called every :data:`CLOCK_PERIOD_S`."""
        end_s = self._clock_s() + CLOCK_PERIOD_S
        while self._streamed and self._clock_s() < end_s:
            self._handle(*self._streamed.popleft())
        self._process_waiting()
        self._overdue_s = self._clock_s() + CLOCK_PERIOD_S + OVERDUE_S

    def clear(self) -> None:
        """Forgets all waiting messages, and the time of the last :meth:`run`."""
        self._streamed.clear()
        self._waiting.clear()
        self._overdue_s = math.inf

    def take_skipped(self) -> Counter[CallKind]:
        """Number of messages skipped since the last call, per input."""
        skipped, self._skipped = self._skipped, Counter()
        return skipped

    def _put_streamed(self, kind: CallKind, data: bytes) -> None:
        if not self._streamed and not self.behind:
            self._handle(kind, data)
            return
        same = [index for index, entry in enumerate(self._streamed) if entry[0] is kind]
        if len(same) >= DEPTH:
            del self._streamed[same[0]]
            self._skipped[kind] += 1
        self._streamed.append((kind, data))

    def _process_waiting(self) -> None:
        start_s = self._clock_s()
        if not self._waiting or start_s < self._next_s:
            return
        kind, data = self._waiting.popleft()
        try:
            self._handle(kind, data)
        finally:
            end_s = self._clock_s()
            self._next_s = end_s + SHARE * (end_s - start_s)

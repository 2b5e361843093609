"""A recorded loop with the events of a node at chosen times: joint states, clock calls and targets.

Events are due at regular times. The process may be held up; then all that queued up is processed at once, as DDS
delivers it: the ten newest joint states, then the clock call, then the targets.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from loop import Loop
from recorded_loop import recorded_loop

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import JointSample
from ik_node.math.types import Array

MS = NS // 1000
QUEUE = 10


class TimedLoop:
    """Joint states at 500 Hz, clock calls at 100 Hz, targets at 50 Hz on a slow line, in steps of 1 ms."""

    def __init__(self, directory: Path) -> None:
        self.loop: Loop = recorded_loop(directory)
        self.transport_ms = 0
        """Age of a target when it arrives."""
        self.stamped = True
        self.is_lost: Callable[[int], bool] = lambda number: False
        """Whether a target, by its number, is lost."""
        self.silent = False
        """The driver publishes no joint states."""
        self.waits = False
        """Joint states queue up, and clock calls continue."""
        self.reasons: list[str] = []
        self.waiting: list[int] = []
        """Times at which targets were sent that have not arrived yet, ns."""
        self.sent = 0
        self._start = self.loop.pose()
        self._begin_ns = self._state_ns = self._clock_ns = self._target_ns = self.loop.time_ns

    def hold_up(self, duration_ms: int) -> None:
        """The process does not run; all queues."""
        self.loop.time_ns += duration_ms * MS
        self._events()

    def run(self, duration_ms: int) -> None:
        for _ in range(duration_ms):
            self.loop.time_ns += MS
            self._events()

    def pose(self, time_ns: int) -> Array:
        """0.05 m/s sideways."""
        moved: Array = self._start.copy()
        moved[1, 3] += 0.05 * (time_ns - self._begin_ns) / NS
        return moved

    def _events(self) -> None:
        loop, controller, now = self.loop, self.loop.controller, self.loop.now
        due = range(self._state_ns, loop.time_ns + 1, 2 * MS)
        if self.waits:
            due = due[:0]
        self._state_ns += len(due) * 2 * MS
        for time_ns in [] if self.silent else due[-QUEUE:]:
            sample = JointSample(now.ros_ns - (loop.time_ns - time_ns), loop.robot.joints, loop.arm.advance(time_ns)[0])
            if loop.take(controller.on_joint_state(sample, now)) is not None:
                self._note()
        if loop.time_ns >= self._clock_ns:
            self._clock_ns = loop.time_ns + 10 * MS
            loop.take(controller.on_clock(now))
            self._note()
        while self._target_ns <= loop.time_ns:
            self.waiting += [] if self.is_lost(self.sent) else [self._target_ns]
            self.sent += 1
            self._target_ns += 20 * MS
        while self.waiting and self.waiting[0] + self.transport_ms * MS <= loop.time_ns:
            time_ns = self.waiting.pop(0)
            loop.target(self.pose(time_ns), now.ros_ns - (loop.time_ns - time_ns) if self.stamped else 0)

    def _note(self) -> None:
        reason = self.loop.controller.status.reason
        if not self.reasons or self.reasons[-1] != reason:
            self.reasons.append(reason)

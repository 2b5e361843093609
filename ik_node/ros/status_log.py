"""Log of the status: each change of state is one line, and so is each new warning or error, whoever reports it."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ik_node.interfaces.step import Level, Mode, Status

REPEAT_S = 10.0
"""A text that appears again within this time is not logged again: conditions near a limit come and go."""
PERIOD_S = 1.0
"""Mean time between two lines; a status that changes with each message of a flood gives no more."""
BURST = 10.0
"""Lines that may follow each other at once. Of more, the one that lasts is logged after :data:`PERIOD_S`."""
MOST_TEXTS = 100
"""Texts that are remembered."""


class StatusLog:
    """Logs each change of the mode, new reasons at level OK, and the statuses at level WARN and ERROR."""

    def __init__(self, write: Callable[[Level, str], None], clock_s: Callable[[], float] = time.monotonic) -> None:
        """``write`` logs a line at a level; ``clock_s`` returns a monotonic time, s."""
        self._write = write
        self._clock_s = clock_s
        self._last: Status | None = None
        self._mode: Mode | None = None
        self._cause = ""
        self._until_s: dict[str, float] = {}
        self._next_s = 0.0

    def add(self, status: Status) -> None:
        """Log the present status if it is new; to be called often, also with the same status."""
        if status == self._last:
            return
        line, now_s = f"{status.mode.value}: {status.reason}", self._clock_s()
        # What follows the first semicolon comes and goes, and is logged with its warning.
        cause = status.reason.partition(";")[0]
        is_fine = status.level is Level.OK
        is_change = status.mode is not self._mode or (is_fine and cause != self._cause)
        if is_change or (not is_fine and now_s >= self._until_s.get(line, 0.0)):
            if now_s < self._next_s - (BURST - 1.0) * PERIOD_S:
                return  # tried again with the next call
            self._next_s = max(self._next_s, now_s) + PERIOD_S
            if len(self._until_s) >= MOST_TEXTS:
                self._until_s.clear()
            self._until_s[line] = now_s + REPEAT_S
            self._write(status.level, line)
            self._mode = status.mode
            self._cause = cause if is_fine or is_change else self._cause
        self._last = status


def log_line(node: Any, level: Level, line: str) -> None:
    """Log a line of ``node`` at the level of a status; rclpy requires one place in the source per level."""
    if level is Level.OK:
        node.get_logger().info(line)
    elif level is Level.WARN:
        node.get_logger().warning(line)
    else:
        node.get_logger().error(line)

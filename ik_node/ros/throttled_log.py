"""Log of a node for texts that may come at the rate of its inputs: at most one per second and subject.

The throttle of rclpy looks up the caller in the source files at every call, which takes 0.2 ms and more: a flood of
refused messages spent most of its time there.
"""

from __future__ import annotations

import math
import time
from typing import Any

PERIOD_S = 1.0
"""Shortest time between two texts about one subject."""


class ThrottledLog:
    """Warnings and errors of a node."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._next_s: dict[str, float] = {}

    def warning(self, subject: str, text: str) -> None:
        """Log a warning; ``subject`` is one of few, such as the name of an input."""
        if self._is_due(subject, PERIOD_S):
            self._node.get_logger().warning(text)

    def warning_once(self, subject: str, text: str) -> None:
        """Log a warning the first time."""
        if self._is_due(subject, math.inf):
            self._node.get_logger().warning(text)

    def error(self, subject: str, text: str) -> None:
        """Log an error."""
        if self._is_due(subject, PERIOD_S):
            self._node.get_logger().error(text)

    def _is_due(self, subject: str, period_s: float) -> bool:
        now_s = time.monotonic()
        is_due = now_s >= self._next_s.get(subject, 0.0)
        if is_due:
            self._next_s[subject] = now_s + period_s
        return is_due

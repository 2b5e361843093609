"""Waiting for other processes and threads: for a condition, never for a fixed time."""

from __future__ import annotations

import threading
from collections.abc import Callable

ENOUGH_S = 300.0
"""Time-out that only a defect exceeds, also on a busy machine."""


def wait_until(condition: Callable[[], bool], within_s: float = ENOUGH_S) -> None:
    """Return once ``condition()`` is true; it is evaluated 100 times per second."""
    pause = threading.Event()
    for _ in range(int(100 * within_s)):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError(f"not within {within_s:g} s")

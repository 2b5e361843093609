"""Waiting for other processes and threads: for a condition, never for a time."""

from __future__ import annotations

import threading
from collections.abc import Callable

ENOUGH_S = 300.0
"""What nothing takes that is not broken, on a machine that is busy otherwise."""


def wait_until(condition: Callable[[], bool], within_s: float = ENOUGH_S) -> None:
    """Returns once ``condition()`` is true; it is asked a hundred times a second."""
    pause = threading.Event()
    for _ in range(int(100 * within_s)):
        if condition():
            return
        pause.wait(0.01)
    raise AssertionError(f"not within {within_s:g} s")

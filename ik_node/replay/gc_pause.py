"""Less frequent garbage collection during a replay."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

THRESHOLD = 100_000
"""New objects before a collection. Python's default of 700 is reached within 10 control steps."""


@contextmanager
def infrequent_gc() -> Iterator[None]:
    """Raises the threshold of Python's garbage collector.

    A replay creates and keeps hundreds of thousands of objects with hardly any garbage; collections would cost up to
    10 us per control step.
    """
    default = gc.get_threshold()
    gc.set_threshold(THRESHOLD, *default[1:])
    try:
        yield
    finally:
        gc.set_threshold(*default)

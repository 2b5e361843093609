"""Python's search for garbage, while there is none."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = 100_000
"""New objects after which to look for garbage; Python's own 700 are made in 10 ticks."""


@contextmanager
def seldom_collecting() -> Iterator[None]:
    """A run makes and keeps hundreds of thousands of objects, among which there is hardly any garbage.

    Looking for it costs up to 10 us of each tick.
    """
    usual = gc.get_threshold()
    gc.set_threshold(SELDOM, *usual[1:])
    try:
        yield
    finally:
        gc.set_threshold(*usual)

"""ROS domains that nobody else who runs these tests is in: no other worker, no other run, on this computer.

A domain is reserved by a lock on a file, which the system gives back when its owner ends, however it ends.
"""

from __future__ import annotations

import fcntl
import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FOLDER = Path(tempfile.gettempdir()) / f"ik_node_test_domains_{os.getuid()}"
DOMAINS = range(1, 102)
"""Not 0, which is everybody's; above 101 the ports meet those that Linux gives to anyone who asks."""
PATIENCE_S = 600.0

_next = os.getpid()
"""Where to look first: a domain is best left alone for a while after its use."""


def free_domain(folder: Path) -> tuple[int, int] | None:
    """A domain that is now ours and the descriptor that keeps it so; None when all are taken."""
    global _next  # noqa: PLW0603
    folder.mkdir(parents=True, exist_ok=True)
    for _ in DOMAINS:
        _next += 1
        domain = DOMAINS[_next % len(DOMAINS)]
        descriptor = os.open(folder / str(domain), os.O_RDWR | os.O_CREAT, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
        else:
            return domain, descriptor
    return None


@contextmanager
def own_domain(folder: Path = FOLDER) -> Iterator[int]:
    """A domain for as long as this lasts; waits while all of them are taken."""
    until = time.monotonic() + PATIENCE_S
    while (found := free_domain(folder)) is None:
        if time.monotonic() > until:
            raise TimeoutError(f"all ROS domains are taken; see {folder}")
        time.sleep(0.1)
    domain, descriptor = found
    try:
        yield domain
    finally:
        os.close(descriptor)

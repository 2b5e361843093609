"""Reservation of ROS domains: no two test processes on this computer use the same domain.

A domain is reserved by a lock on a file. The operating system releases the lock when the process ends, also after a
crash.
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
"""0 is excluded because it is the default domain; above 101 the ports overlap with the ephemeral ports of Linux."""
PATIENCE_S = 600.0

_next = os.getpid()
"""Next domain to try: a domain that was just released is not reused immediately."""


def free_domain(folder: Path) -> tuple[int, int] | None:
    """Reserve a domain; return it with the file descriptor that holds the lock, or None when all are in use."""
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
    """Reserve a domain for the duration of the context; wait while all are in use."""
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

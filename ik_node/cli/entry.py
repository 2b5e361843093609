"""What every command line shares: an end without a traceback when nobody reads on, as in ``ik_report BAG | head``."""

from __future__ import annotations

import functools
import os
import select
import sys
from collections.abc import Callable, Sequence

UNREAD = 141
"""Exit code when the reader of our output went away: what a shell says of a process that SIGPIPE ended."""

Main = Callable[[Sequence[str] | None], int]


def command_line(main: Main) -> Callable[..., int]:
    """``main(arguments=None)``, which ends quietly with ``UNREAD`` when the reader of its output has gone away.

    Not by the signal SIGPIPE, which would end a node for any connection that breaks: a BrokenPipeError of something
    other than our own output goes on to the caller.
    """

    @functools.wraps(main)
    def wrapped(arguments: Sequence[str] | None = None) -> int:
        try:
            try:
                return main(arguments)
            finally:
                sys.stdout.flush()  # here and not at exit, where an error could no longer be handled
        except BrokenPipeError:
            if not _unread():
                raise
            return UNREAD

    return wrapped


def _unread() -> bool:
    """Whether an output has lost its reader; such an output leads nowhere from then on, and exit flushes in peace."""
    lost = False
    for stream in (sys.stdout, sys.stderr):
        try:
            number = stream.fileno()
        except (OSError, ValueError):  # not a file: a test's, or closed
            continue
        # The kernel is asked: an unbuffered stream has nothing left whose flush could fail.
        poll = select.poll()
        poll.register(number, select.POLLOUT)
        if any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0)):
            lost = True
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, number)
            os.close(nowhere)
    return lost

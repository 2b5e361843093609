"""Common part of all command lines: no traceback for a closed output (``... | head``) or a missing package."""

from __future__ import annotations

import functools
import gc
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from ik_node.errors import EXTRAS, MissingPackageError, PackagesError, one_line

CLOSED_OUTPUT = 141
"""Exit code when the reader of the output has closed it: that of a process ended by SIGPIPE in a shell."""
UNUSABLE = 2
"""Exit code when a package is missing or does not fit, or a file cannot be opened."""
INTERRUPTED = 130
"""Exit code after Ctrl-C: that of a process ended by SIGINT in a shell."""

Main = Callable[[Sequence[str] | None], int]


def command_line(main: Main) -> Callable[..., int]:
    """Decorate ``main(arguments=None)``.

    The result returns :data:`CLOSED_OUTPUT` when the reader of stdout or stderr has closed it. The signal SIGPIPE keeps
    its Python default, since it would end a node for any broken connection; a BrokenPipeError of another file is
    raised.
    When a package of an extra is missing, numerical packages do not fit together, or a file cannot be opened, the
    result prints one line and returns :data:`UNUSABLE`; after Ctrl-C it returns :data:`INTERRUPTED`.
    """

    @functools.wraps(main)
    def wrapped(arguments: Sequence[str] | None = None) -> int:
        try:
            try:
                return main(arguments)
            finally:
                sys.stdout.flush()  # here and not at exit, where an error could no longer be handled
        except BrokenPipeError:
            if not _is_output_closed():
                raise
            return CLOSED_OUTPUT
        except OSError as error:
            if error.filename is None:
                raise
            print("error:", one_line(f"'{error.filename}': {error.strerror}"), file=sys.stderr)
            return UNUSABLE
        except KeyboardInterrupt:
            return INTERRUPTED
        except PackagesError as error:
            print(f"error: {error}", file=sys.stderr)
            return UNUSABLE
        except ModuleNotFoundError as error:
            if (error.name or "").partition(".")[0] not in EXTRAS:
                raise
            print(f"error: {MissingPackageError(error)}", file=sys.stderr)
            return UNUSABLE

    return wrapped


@contextmanager
def imports() -> Iterator[None]:
    """Import without garbage collection, a tenth of the start of a node; what was imported is excluded from it."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _is_output_closed() -> bool:
    """Return whether stdout or stderr has lost its reader; redirect it to /dev/null, so that it can be flushed."""
    closed = False
    for stream in (sys.stdout, sys.stderr):
        try:
            number = stream.fileno()
        except (OSError, ValueError):  # not a file (in a test), or closed
            continue
        # Poll the descriptor: an unbuffered stream has nothing left to flush that could fail.
        poll = select.poll()
        poll.register(number, select.POLLOUT)
        if any(events & (select.POLLERR | select.POLLHUP) for _, events in poll.poll(0)):
            closed = True
            devnull = os.open(os.devnull, os.O_WRONLY)
            os.dup2(devnull, number)
            os.close(devnull)
    return closed

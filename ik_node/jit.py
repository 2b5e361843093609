"""Functions compiled to machine code by numba, for what every tick does many times.

A compiled function is Python without Python's objects: numbers, arrays, tuples and NamedTuples of them. It gives the
bits of the interpreter (no sums in another order, no fused operations), many times faster.

It is compiled when it is first called with arguments of new types, which takes seconds, and kept on disk from then on.
:func:`ik_node.control.warm_up.rehearse` calls everything that a tick may call: nothing is compiled while an arm moves.
Arrays handed to a compiled function are therefore C-contiguous float64 always: another memory layout is another type.
What is kept is kept per digest of our code: numba notices a change of a function, but not one of a function in another
file that it calls.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from ik_node.source import source_digest

Function = TypeVar("Function", bound=Callable[..., Any])

REHEARSED = "rehearsed"
KEPT = 8
"""So many versions of the package keep their machine code."""
ROOM = 100_000_000
"""Free bytes without which nothing is kept: a version takes a tenth of it."""


def _folder() -> Path | None:
    """Where machine code of this version of the package is kept; None where nothing can be written, or hardly."""
    try:
        home = Path(os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        home = home / "ik_node"
        folder = home / source_digest()
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        with contextlib.suppress(OSError):  # another process tidies up too
            for old in sorted(home.iterdir(), key=lambda path: path.stat().st_mtime)[:-KEPT]:
                shutil.rmtree(old, ignore_errors=True)
        roomy = shutil.disk_usage(folder).free > ROOM
    except (OSError, RuntimeError):  # RuntimeError: no home
        return None
    return folder if roomy and os.access(folder, os.W_OK) else None


CACHE = _folder()
"""Folder of the machine code; None: it is compiled anew in every process."""
if CACHE is not None:
    numba.config.CACHE_DIR = str(CACHE)

_dispatchers: list[Any] = []
_ufuncs: list[Any] = []


def compiled(function: Function) -> Function:
    """``function`` as machine code; division by zero gives inf or NaN, as in NumPy, and indices are not checked."""
    _dispatchers.append(numba.njit(cache=CACHE is not None, error_model="numpy")(function))
    return cast(Function, _dispatchers[-1])


def elementwise(function: Function) -> Callable[..., Any]:
    """A function of numbers as one of arrays, with NumPy's broadcasting."""
    _ufuncs.append(numba.vectorize(cache=CACHE is not None)(function))
    return cast(Callable[..., Any], _ufuncs[-1])


def first_time() -> bool:
    """True until a rehearsal of this version has come to its end here: compiling all of it takes half a minute."""
    return CACHE is None or not (CACHE / REHEARSED).exists()


def rehearsed() -> None:
    """A rehearsal has come to its end."""
    if CACHE is not None:
        with contextlib.suppress(OSError):
            (CACHE / REHEARSED).touch()


def compilations() -> int:
    """How often something has been compiled, or fetched from where it is kept, in this process."""
    return sum(len(one.signatures) for one in _dispatchers) + sum(len(one.types) for one in _ufuncs)

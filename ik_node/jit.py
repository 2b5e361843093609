"""Functions compiled to machine code by numba, for what every control step computes many times.

A compiled function is Python without Python's objects: numbers, arrays, tuples and NamedTuples of them. It gives the
bits of the interpreter (no sums in another order, no fused operations), many times faster.

It is compiled at its first call with arguments of new types, which takes seconds; the machine code is stored on disk.
:func:`ik_node.control.warm_up.warm_up` calls everything that a control step may call, so that nothing is compiled while
an arm moves. Arrays passed to a compiled function are C-contiguous float64: another memory layout is another type.

Machine code is stored in a folder whose name is a digest of everything that it depends on: the modules that define
compiled functions, the records of interfaces/ that these take and return, where the package is installed, Python, numba
and the processor. numba itself notices a change of a function, but not of a function in another file that it calls.
Constants of compiled functions are defined in these modules, too; a test checks this.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from ik_node import dependencies

dependencies.check(dependencies.COMPILED)  # before numba: a misfit must not change numbers

import numba
from llvmlite import binding

Function = TypeVar("Function", bound=Callable[..., Any])

MAX_STORED_VERSIONS = 8
"""Folders of machine code kept on disk; the least recently used ones are removed."""
MIN_FREE_BYTES = 100_000_000
"""Free disk space below which nothing is stored: a version takes a tenth of it."""
_WARM = "warm"
_IMPORT = b"\nfrom ik_node.jit import"


@cache
def cache_folder() -> Path | None:
    """Folder of this version's machine code; None where it cannot be written.

    The first of these that is set: ``$NUMBA_CACHE_DIR/ik_node``, ``$XDG_CACHE_HOME/ik_node``, ``~/.cache/ik_node``.
    """
    try:
        home = Path(os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = home / "ik_node" / _cache_key()
        folder.mkdir(parents=True, exist_ok=True)
        has_space = shutil.disk_usage(folder).free > MIN_FREE_BYTES
    except (OSError, RuntimeError):  # RuntimeError: no home
        return None
    return folder if has_space and os.access(folder, os.W_OK) else None


def _cache_key() -> str:
    package = Path(__file__).parent
    digest = hashlib.sha256()
    for part in (str(package), sys.version, numba.__version__, binding.get_host_cpu_name()):
        digest.update(part.encode() + b"\0")
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if path.name == "jit.py" or path.parent.name == "interfaces" or _IMPORT in source:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + source + b"\0")
    return digest.hexdigest()[:16]


_dispatchers: list[Any] = []
_ufuncs: list[Any] = []


@contextlib.contextmanager
def _numba_cache() -> Iterator[bool]:
    """numba's cache in our folder while one function is declared; yields whether there is one."""
    folder, previous = cache_folder(), numba.config.CACHE_DIR
    if folder is not None:
        numba.config.CACHE_DIR = str(folder)
    try:
        yield folder is not None
    finally:
        numba.config.CACHE_DIR = previous


def compiled(function: Function) -> Function:
    """``function`` as machine code; division by zero gives inf or NaN, as in NumPy, and indices are not checked."""
    with _numba_cache() as cached:
        _dispatchers.append(numba.njit(cache=cached, error_model="numpy")(function))
    return cast(Function, _dispatchers[-1])


def elementwise(function: Function) -> Callable[..., Any]:
    """A function of numbers as one of arrays, with NumPy's broadcasting."""
    with _numba_cache() as cached:
        _ufuncs.append(numba.vectorize(cache=cached)(function))
    return cast(Callable[..., Any], _ufuncs[-1])


def is_cold() -> bool:
    """True until :func:`mark_warm` was called for this version on this machine: compiling all of it takes a minute."""
    folder = cache_folder()
    return folder is None or not (folder / _WARM).exists()


def mark_warm() -> None:
    """States that the machine code of this version is complete, and removes that of the oldest versions."""
    folder = cache_folder()
    if folder is None:
        return
    with contextlib.suppress(OSError):  # another process removes them too
        (folder / _WARM).touch()
        os.utime(folder)
        for old in sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-MAX_STORED_VERSIONS]:
            shutil.rmtree(old, ignore_errors=True)


def compilation_count() -> int:
    """Number of specialisations that were compiled, or loaded from disk, in this process."""
    return sum(len(one.signatures) for one in _dispatchers) + sum(len(one.types) for one in _ufuncs)

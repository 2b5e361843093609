"""Functions compiled to machine code by numba, for what every control step computes many times.

A compiled function is Python without Python's objects: numbers, arrays, tuples and NamedTuples of them. It gives the
bits of the interpreter (no sums in another order, no fused operations), many times faster.

It is compiled at its first call with arguments of new types, which takes seconds; the machine code is stored on disk.
:func:`ik_node.control.warm_up.warm_up` calls everything that a control step may call, so that nothing is compiled while
an arm moves; :mod:`ik_node.control.compilation` divides the compilation among processes. Arrays passed to a compiled
function are C-contiguous float64: another memory layout is another type.

Machine code is stored in a folder whose name is a digest of everything that it depends on: the modules that define
compiled functions, the records of interfaces/ that these take and return, where the package is installed, Python, numba
and the processor with its features. numba itself notices a change of a function, but not of a function in another file
that it calls. Constants of compiled functions are defined in these modules, too; a test checks this. numba compiles
again what is installed again, so the times and sizes of the files, which it compares, are part of the digest, too.

For images and read-only homes: ``NUMBA_CACHE_DIR`` names the folder, ``ik_compile`` fills it, and a complete one that
cannot be written is copied to a temporary folder at the start. ``NUMBA_CPU_NAME=generic`` and an empty
``NUMBA_CPU_FEATURES`` make it independent of the processor.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import hashlib
import os
import shutil
import sys
import tempfile
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from ik_node import dependencies

dependencies.check(dependencies.COMPILED)  # before numba: a misfit must not change numbers

import numba
from llvmlite import binding
from numba.core import caching, codegen, compiler, event

Function = TypeVar("Function", bound=Callable[..., Any])

MAX_STORED_VERSIONS = 8
"""Folders of machine code kept on disk; the least recently used ones are removed."""
MIN_FREE_BYTES = 100_000_000
"""Free disk space below which nothing is stored: a version takes a tenth of it."""
REPORT_EVERY = 10
"""Functions per report of progress: some seconds."""
_WARM, _LOCKS = "warm", "locks"
_IMPORT = b"\nfrom ik_node.jit import"


@cache
def cache_folder() -> Path | None:
    """Folder of this version's machine code; None where it cannot be written and is not complete.

    The first of these that is set: ``$NUMBA_CACHE_DIR/ik_node``, ``$XDG_CACHE_HOME/ik_node``, ``~/.cache/ik_node``.
    """
    try:
        home = Path(os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        folder = home / "ik_node" / _cache_key()
        if (folder / _WARM).exists() and not os.access(folder, os.W_OK):
            return _copied(folder)
        folder.mkdir(parents=True, exist_ok=True)
        has_space = shutil.disk_usage(folder).free > MIN_FREE_BYTES
    except (OSError, RuntimeError):  # RuntimeError: no home
        return None
    return folder if has_space and os.access(folder, os.W_OK) else None


def _copied(folder: Path) -> Path:
    """A temporary copy, until this process ends: numba reads no folder that it cannot write."""
    copy = Path(tempfile.mkdtemp(prefix="ik_node_"))
    atexit.register(shutil.rmtree, copy, ignore_errors=True)
    shutil.copytree(folder, copy, copy_function=shutil.copyfile, dirs_exist_ok=True)
    for place in (copy, *filter(Path.is_dir, copy.rglob("*"))):
        place.chmod(0o700)
    return copy


def _cache_key() -> str:
    package = Path(__file__).parent
    digest = hashlib.sha256()
    cpu = numba.config.CPU_NAME or binding.get_host_cpu_name()
    features = numba.config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    for part in (str(package), sys.version, numba.__version__, cpu, features):
        digest.update(part.encode() + b"\0")
    for path in sorted(package.rglob("*.py")):
        source, status = path.read_bytes(), path.stat()
        if path.name == "jit.py" or path.parent.name == "interfaces" or _IMPORT in source:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + source + b"\0")
            digest.update(f"{status.st_mtime} {status.st_size}\0".encode())
    return digest.hexdigest()[:16]


IS_KNOWN = numba.__version__.startswith("0.68.")
"""Whether the parts of numba that :class:`_LoadedLibrary` replaces are those that it was written for. Any other version
loads functions by itself, which takes half a second more at each start."""


class _LoadedLibrary(codegen.JITCodeLibrary):  # type: ignore[misc]  # numba has no types
    """A function loaded from disk, whose LLVM code is read only when another function that calls it is compiled.

    numba reads it and lists its symbols at once, which takes more time than loading the machine code.
    """

    _bitcode = b""

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        """As numba's method."""
        name, kind, data = state
        if kind != "object":
            return super()._unserialize(codegen, state)
        library = codegen.create_library(name)
        library.enable_object_caching()
        machine_code, library._bitcode = data
        library._set_compiled_object(machine_code)
        library._finalize_final_module()
        return library

    def _get_module_for_linking(self) -> Any:
        """As numba's method."""
        if self._bitcode:
            self._shared_module = binding.parse_bitcode(self._bitcode)
            self._bitcode = b""
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()

    def get_pointer_to_function(self, name: str) -> int:
        """As numba's method, for a symbol that is not in numba's list."""
        self._ensure_finalized()
        return int(self._codegen._engine.get_function_address(name))


class _LoadedFunction(caching.CompileResultCacheImpl):  # type: ignore[misc]  # numba has no types
    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """As numba's method; called with numba's lock of the compiler."""
        engine = target_context.codegen()
        previous = engine._library_class
        engine._library_class = _LoadedLibrary
        try:
            return compiler.CompileResult._rebuild(target_context, *payload)
        finally:
            engine._library_class = previous


class _FunctionCache(caching.FunctionCache):  # type: ignore[misc]  # numba has no types
    _impl_class = _LoadedFunction


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
        dispatcher = numba.njit(error_model="numpy", no_cfunc_wrapper=True)(function)  # nothing calls it from C
        if cached and IS_KNOWN:
            dispatcher._cache = _FunctionCache(function)
        elif cached:
            dispatcher.enable_caching()
    _dispatchers.append(dispatcher)
    return cast(Function, dispatcher)


def elementwise(function: Function) -> Callable[..., Any]:
    """A function of numbers as one of arrays, with NumPy's broadcasting."""
    with _numba_cache() as cached:
        _ufuncs.append(numba.vectorize(cache=cached)(function))
    return cast(Callable[..., Any], _ufuncs[-1])


def is_cold() -> bool:
    """True until :func:`mark_warm` was called for this version on this machine: compiling it all takes a minute."""
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


class CompilationProgress:
    """Reports how many functions were begun, and which one is, every :data:`REPORT_EVERY` functions."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._begun = set[str]()

    def begin(self, name: str) -> None:
        """Called when the compilation of a function begins, in this or in another process; once or more often."""
        if name not in self._begun:
            self._begun.add(name)
            if len(self._begun) % REPORT_EVERY == 1:
                count = f"{len(self._begun)} of up to {len(_dispatchers)} functions"
                self._report(f"compiling, once per version: {count}: {name}")


class _CompilationListener(event.Listener):  # type: ignore[misc]  # numba has no types
    """Passes the name of each function that numba begins to compile; numba has no event for one that is loaded."""

    def __init__(self, begin: Callable[[str], None]) -> None:
        self._begin = begin
        self._known = {id(dispatcher) for dispatcher in _dispatchers}

    def on_start(self, event: Any) -> None:
        dispatcher = event.data["dispatcher"]
        if id(dispatcher) in self._known:  # not a function of numba itself
            self._begin(_name(dispatcher))

    def on_end(self, event: Any) -> None:
        """Nothing to report."""


def _name(dispatcher: Any) -> str:
    function = dispatcher.py_func
    return f"{function.__module__.removeprefix('ik_node.')}.{function.__name__}"


@contextlib.contextmanager
def compilation_reports(report: Callable[[str], None]) -> Iterator[CompilationProgress]:
    """Passes texts to ``report`` while functions are compiled; none when all of them are loaded from disk."""
    progress = CompilationProgress(report)
    with event.install_listener("numba:compile", _CompilationListener(progress.begin)):
        yield progress


@contextlib.contextmanager
def shared_compilation(folder: Path, begin: Callable[[str], None]) -> Iterator[None]:
    """Compiles in this process only what no other process with the same ``folder`` is compiling.

    A function that another process is compiling is interpreted when Python calls it, which gives the same result; a
    function being compiled waits for it, and then loads it. Locks are held by functions and those that they call,
    which do not call them back: processes cannot wait for each other in a circle.

    Args:
        folder: That of :func:`cache_folder`.
        begin: Receives the name of each function whose compilation begins.
    """
    with (folder / _LOCKS).open("w") as file, contextlib.ExitStack() as patches:
        patches.enter_context(event.install_listener("numba:compile", _CompilationListener(begin)))
        for dispatcher in _dispatchers:
            lock = _FunctionLock(file.fileno(), dispatcher)
            for name, replacement in (("compile", lock.compile), ("_compile_for_args", lock.compile_or_interpret)):
                setattr(dispatcher, name, replacement)
                patches.callback(delattr, dispatcher, name)
        yield


class _FunctionLock:
    """One byte of a file, locked by the process that compiles this function; the kernel releases it if that ends."""

    _interpreting = False

    def __init__(self, file: int, dispatcher: Any) -> None:
        self._file = file
        self._place = zlib.crc32(_name(dispatcher).encode())
        self._function = dispatcher.py_func
        self._compile, self._compile_for_args = dispatcher.compile, dispatcher._compile_for_args

    def compile(self, signature: Any) -> Any:
        """As numba's method: compiles or loads, and returns the entry point."""
        fcntl.lockf(self._file, fcntl.LOCK_EX, 1, self._place)
        try:
            return self._compile(signature)
        finally:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, self._place)

    def compile_or_interpret(self, *arguments: Any) -> Callable[..., Any]:
        """As numba's method: returns what is then called with these arguments."""
        if _FunctionLock._interpreting:
            return cast(Callable[..., Any], self._function)
        try:
            fcntl.lockf(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, self._place)
        except (BlockingIOError, PermissionError):
            return self._interpreted
        try:
            return cast(Callable[..., Any], self._compile_for_args(*arguments))  # calls compile
        finally:
            fcntl.lockf(self._file, fcntl.LOCK_UN, 1, self._place)

    def _interpreted(self, *arguments: Any) -> Any:
        _FunctionLock._interpreting = True  # with the functions that it calls, whose arguments have other types here
        try:
            return self._function(*arguments)
        finally:
            _FunctionLock._interpreting = False

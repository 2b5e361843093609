"""The stored machine code: what its key covers, and that importing the module has no side effect."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import PROJECT, skip_unless_others_can_read

PACKAGE = PROJECT / "ik_node"
CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")
COMPILERS = {"compiled", "elementwise"}


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(PROJECT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def defines_compiled_functions(module: str) -> bool:
    """True as defined by :mod:`ik_node.jit`."""
    return "\nfrom ik_node.jit import" in MODULES[module].read_text()


def belongs_to_key(module: str) -> bool:
    """True for these files and for the records of interfaces/, which compiled functions take and return."""
    return defines_compiled_functions(module) or module.startswith("ik_node.interfaces.")


def imported_names(tree: ast.Module) -> dict[str, tuple[str, str]]:
    """Name in this module -> module of the package and name there; the name is empty for a module."""
    found: dict[str, tuple[str, str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ik_node"):
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                found[alias.asname or alias.name] = (whole, "") if whole in MODULES else (str(node.module), alias.name)
    return found


def compiled_functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Functions that are decorated with, or passed to, one of the compilers."""
    passed = {
        argument.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in COMPILERS
        for argument in node.args
        if isinstance(argument, ast.Name)
    }
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            decorators = {decorator.id for decorator in node.decorator_list if isinstance(decorator, ast.Name)}
            if decorators & COMPILERS or node.name in passed:
                yield node


def foreign_constants(function: ast.FunctionDef, names: dict[str, tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Module and name of every constant of another module that ``function`` uses."""
    for node in ast.walk(function):
        if isinstance(node, ast.Name) and CONSTANT.fullmatch(node.id) and node.id in names:
            yield names[node.id]
        elif isinstance(node, ast.Attribute) and CONSTANT.fullmatch(node.attr) and isinstance(node.value, ast.Name):
            module, name = names.get(node.value.id, ("", "x"))
            if not name:
                yield module, node.attr


@pytest.mark.parametrize("module", [name for name in MODULES if defines_compiled_functions(name)])
def test_constants_of_compiled_functions_belong_to_the_key(module: str) -> None:
    """numba compiles constants into the code: a constant in a module outside the key could change without
    recompilation."""
    tree = ast.parse(MODULES[module].read_text())
    functions, names = list(compiled_functions(tree)), imported_names(tree)
    assert functions or not COMPILERS & names.keys()
    for function in functions:
        for source, constant in foreign_constants(function, names):
            assert belongs_to_key(source), f"{module}.{function.name} uses {source}.{constant}"


def test_the_check_finds_a_constant_outside_the_key() -> None:
    source = (
        "from ik_node.jit import compiled\nfrom ik_node.errors import LIMIT\nfrom ik_node import errors\n"
        "@compiled\ndef f(x): return x * LIMIT + errors.OTHER\n"
    )
    tree = ast.parse(source)
    names = imported_names(tree)
    found = [constant for function in compiled_functions(tree) for constant in foreign_constants(function, names)]
    assert sorted(found) == [("ik_node.errors", "LIMIT"), ("ik_node.errors", "OTHER")]


def run(code: str, package: Path, home: Path) -> str:
    """Output of ``code`` with the package of ``package`` and an empty home."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "XDG_CACHE"))}
    environment |= {"PYTHONPATH": str(package), "HOME": str(home), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=home, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_creates_no_folder_and_leaves_numba_alone(tmp_path: Path) -> None:
    code = "import numba; before = numba.config.CACHE_DIR; import ik_node.jit; print(before == numba.config.CACHE_DIR)"
    assert run(code, PROJECT, tmp_path) == "True"
    assert list(tmp_path.iterdir()) == []


def test_declaring_a_function_leaves_numba_alone(tmp_path: Path) -> None:
    code = "import numba; old = numba.config.CACHE_DIR; import ik_node.math.se3; print(old == numba.config.CACHE_DIR)"
    assert run(code, PROJECT, tmp_path) == "True"


def test_the_key_depends_on_the_path_and_the_source_of_compiled_functions(tmp_path: Path) -> None:
    """Checked with a copy of the package at another path, then with another constant, then with another docstring."""
    code = "from ik_node.jit import cache_folder; print(cache_folder().name)"
    copy = tmp_path / "copy"
    shutil.copytree(PACKAGE, copy / "ik_node", ignore=shutil.ignore_patterns("__pycache__"))
    here, there = run(code, PROJECT, tmp_path), run(code, copy, tmp_path)
    assert here == run(code, PROJECT, tmp_path)
    assert here != there
    program = copy / "ik_node" / "differential_ik" / "exact_program.py"
    program.write_text(program.read_text().replace("ROUNDING = 1e-12", "ROUNDING = 1e-13"))
    changed = run(code, copy, tmp_path)
    assert changed != there
    errors = copy / "ik_node" / "errors.py"
    errors.write_text(errors.read_text() + "\n# not compiled\n")
    assert run(code, copy, tmp_path) == changed
    written = program.stat().st_mtime
    os.utime(program, (written, written + 1.0))  # installed again: numba compiles it again
    assert run(code, copy, tmp_path) != changed


COMPILED = """
from ik_node.jit import compilation_reports, compiled

@compiled
def increased(number):
    return number + 1.0

with compilation_reports(print):
    increased(1.0)
"""


def test_progress_is_reported_while_something_is_compiled(tmp_path: Path) -> None:
    """The second process loads the function from disk and reports nothing."""
    program = tmp_path / "program.py"
    program.write_text(COMPILED)
    code = f"import runpy; runpy.run_path({str(program)!r}, run_name='program')"
    assert run(code, PROJECT, tmp_path) == "compiling, once per version: 1 of up to 1 functions: program.increased"
    assert run(code, PROJECT, tmp_path) == ""


SHARED = """
import sys
from ik_node.jit import cache_folder, compiled, shared_compilation

@compiled
def inner(number):
    return number + 1.0

@compiled
def outer(number):
    return 2.0 * inner(number)

def begin(name):
    print("begun", name, flush=True)
    if sys.argv[1] == "first":
        sys.stdin.readline()

with shared_compilation(cache_folder(), begin):
    print("inner", inner(1.0), len(inner.signatures), flush=True)
    if sys.argv[1] == "second":
        print("outer", outer(1.0), len(outer.signatures), len(inner.signatures), flush=True)
"""


def start_sharing(program: Path, which: str) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment |= {"PYTHONPATH": str(PROJECT), "NUMBA_CACHE_DIR": str(program.parent)}
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, program, which], env=environment, stdin=pipe, stdout=pipe, text=True)


def test_processes_divide_the_functions_among_themselves(tmp_path: Path) -> None:
    """While the first compiles the inner function, the second interprets it, and then waits for it in the outer one.

    The inner function has no machine code in the second process until that process loads the code of the first.
    """
    program = tmp_path / "program.py"
    program.write_text(SHARED)
    with start_sharing(program, "first") as first:
        assert first.stdin is not None
        assert first.stdout is not None
        try:
            assert first.stdout.readline() == "begun __main__.inner\n"
            with start_sharing(program, "second") as second:
                assert second.stdout is not None
                try:
                    assert second.stdout.readline() == "inner 2.0 0\n"
                    assert second.stdout.readline() == "begun __main__.outer\n"
                    first.stdin.write("continue\n")
                    first.stdin.flush()
                    assert first.stdout.readline() == "inner 2.0 1\n"
                    assert second.stdout.readline() == "outer 4.0 1 1\n"
                finally:
                    second.kill()
        finally:
            first.kill()


COPIED = """
import os, sys
from pathlib import Path
from ik_node import jit

os.umask(0o022)  # others may read an image
folder = jit.cache_folder()
jit.mark_warm()
(folder / "code").write_text("machine code")
jit.cache_folder.cache_clear()
folder.chmod(0o555)
if os.getuid() == 0:
    os.setuid(65534)  # root may write everywhere
copy = jit.cache_folder()
print(copy != folder, os.access(copy, os.W_OK), (copy / "code").read_text(), copy)
"""


def test_a_complete_folder_that_cannot_be_written_is_copied() -> None:
    """As in an image: its machine code is used, and the copy is removed with the process."""
    skip_unless_others_can_read()
    with tempfile.TemporaryDirectory() as home:  # pytest's own folders may only be entered by their owner
        Path(home).chmod(0o755)
        different, writable, content, copy = run(COPIED, PROJECT, Path(home)).replace("machine code", "code").split()
        assert (different, writable, content) == ("True", "True", "code")
        assert not Path(copy).exists()


LINKED = """
import sys
import numba
import numpy as np
from numba.core import event
if sys.argv[2] == "other":
    numba.__version__ = "0.99.0"
from ik_node.jit import compiled

@compiled
def total(numbers):
    return numbers.sum()

@compiled
def norm(numbers):
    return np.sqrt((numbers * numbers).sum())

@compiled
def doubled_norm(numbers):
    return 2.0 * norm(numbers)

numbers = np.array([3.0, 4.0])
total(numbers)
with event.install_recorder("numba:llvm_lock") as llvm_calls:
    norm(numbers)
with event.install_recorder("numba:compile") as compilations:
    doubled_norm(numbers) if sys.argv[1] == "twice" else norm(numbers)
print(norm.stats.cache_hits.total(), len(llvm_calls.buffer), len(compilations.buffer) // 2, end=" ")
print(doubled_norm(numbers) if sys.argv[1] == "twice" else norm(numbers))
"""


@pytest.mark.parametrize("version", ["known", "other"])
def test_a_loaded_function_is_linked_into_one_compiled_later(version: str, tmp_path: Path) -> None:
    """The LLVM code of a function on disk is not read when it is loaded, which takes hundreds of calls of LLVM.

    Another version of numba than the known one loads functions by itself.
    """
    program = tmp_path / "program.py"
    program.write_text(LINKED)

    def lines(what: str) -> list[str]:
        arguments = ["", what, version]
        code = f"import runpy, sys; sys.argv = {arguments}; runpy.run_path({str(program)!r}, run_name='program')"
        return run(code, PROJECT, tmp_path).split()

    assert lines("once")[0] == "0"
    for expected in ("1", "0"):
        loaded, llvm_calls, compiled, norm = lines("twice")
        assert (loaded, compiled, norm) == ("1", expected, "10.0")
        assert version == "other" or int(llvm_calls) < 100

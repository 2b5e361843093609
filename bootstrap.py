#!/usr/bin/env python3
"""Sets up an environment of the project's own in .venv, with pinned versions, and runs something in it.

    python3 bootstrap.py demo [options of ik_demo]    node, simulated robot, trajectory, recording, report
    python3 bootstrap.py test [options of pytest]     linters, type checks and tests, on every core
    python3 bootstrap.py ik_report BAG ...            any executable of the project

Needs Python 3.10 to 3.13 and nothing else. With a real ROS 2 Jazzy use colcon instead; the README shows how.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn
from urllib.parse import unquote

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / "bin"
SUPPORTED = ((3, 10), (3, 13))
RUNTIME = ROOT / "requirements.txt"
TESTS = ROOT / "requirements-test.txt"
COMPILED = ("daqp", "numba", "numpy", "pin", "PyYAML", "scipy")
"""What the control step is compiled with; installed first, so that it is compiled while the rest is installed."""
SITE = "lib/*/site-packages"
CMEEL = f"{SITE}/cmeel.prefix"
NOT_RUN = (
    *("include", f"{CMEEL}/bin", f"{CMEEL}/include", f"{CMEEL}/share/cmake", f"{CMEEL}/share/doc", f"{CMEEL}/lib*/*.a"),
    *(f"{SITE}/fontTools/**/*.c", f"{SITE}/pip/**/__pycache__", f"{SITE}/setuptools/**/__pycache__"),
    *(f"{SITE}/{package}/**/tests" for package in ("matplotlib", "numba", "numpy", "scipy")),
)
"""Sources, CMake files, programs and static libraries of C++ packages, and tests: 260 MB that nothing reads."""
WITH_SYMBOLS = (
    *(f"{CMEEL}/lib/*.so.*", f"{CMEEL}/{SITE}/*/*.so", f"{SITE}/llvmlite/binding/*.so"),
    *(
        f"{SITE}/{name}*.so"
        for name in ("apsw/", "daqp", "fontTools/**/", "kiwisolver/", "lz4/**/", "matplotlib/", "yaml/", "zstandard/")
    ),
)
"""Libraries with 85 MB of symbols for debuggers, which ``strip`` removes, where there is one. Those of wheels with
libraries from elsewhere (``*.libs``) are left alone: patchelf changed them."""
MESHES = ("stl", "dae", "obj")
MIN_LINKED_BYTES = 65536
ROS_WHEEL_VARIABLES = ("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME")
"""Left behind by another environment's Python, these would keep ours from finding its own libraries."""


def python_version(python: str) -> tuple[int, int] | None:
    """Version of an interpreter; None when it does not run, as a version manager's shim may not."""
    question = "import sys, venv, ensurepip; print(*sys.version_info[:2])"
    try:
        answer = subprocess.run([python, "-c", question], capture_output=True, text=True, timeout=60, check=True)
        major, minor = answer.stdout.split()
    except (OSError, subprocess.SubprocessError, ValueError):
        return None
    return int(major), int(minor)


def choose_python() -> str:
    """The interpreter that runs this, if it is supported, else the first one on PATH that is."""
    for python in (sys.executable, "python3.12", "python3.13", "python3.11", "python3.10", "python3"):
        version = python_version(python)
        if version is not None and SUPPORTED[0] <= version <= SUPPORTED[1]:
            return python
    sys.exit("error: needs Python 3.10 to 3.13 with its venv module (Debian: apt install python3-venv)")


def environment() -> dict[str, str]:
    """The caller's environment, without another environment's Python in it."""
    kept = {name: value for name, value in os.environ.items() if name not in ROS_WHEEL_VARIABLES}
    kept["PATH"] = f"{BIN}{os.pathsep}{kept.get('PATH', '')}"
    kept["AMENT_PREFIX_PATH"] = str(VENV)
    kept["VIRTUAL_ENV"] = str(VENV)
    kept.setdefault("ROS_LOG_DIR", str(VENV / "log"))
    return kept


def set_up(requirements: list[Path]) -> None:
    """Installs ``requirements`` and the project (in place) into .venv; does nothing when that was done before."""
    wanted = "".join(path.read_text() for path in [*requirements, ROOT / "setup.py"])
    digest = hashlib.sha256(wanted.encode()).hexdigest()
    stamp = VENV / f"installed-{len(requirements)}"
    if stamp.is_file() and stamp.read_text() == digest:
        return
    if not (BIN / "python").exists() or python_version(str(BIN / "python")) is None:
        python = choose_python()
        print(f"setting up {VENV} with {python}", flush=True)
        shutil.rmtree(VENV, ignore_errors=True)
        subprocess.run([python, "-m", "venv", str(VENV)], check=True, env=environment())
    # Bytecode is compiled when a module is first imported: of most modules it never is.
    pip = [str(BIN / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile"]
    lists = [part for path in requirements for part in ("-r", str(path))]
    subprocess.run([*pip, "-c", str(RUNTIME), *COMPILED], check=True, env=environment())
    with compiling():
        subprocess.run([*pip, *lists], check=True, env=environment())
        subprocess.run([*pip, "--no-deps", "--editable", str(ROOT)], check=True, env=environment())
        make_small(VENV)
    stamp.write_text(digest)


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Compiles the control step meanwhile, and afterwards: an executable that compiles it, too, does the rest."""
    quiet = subprocess.DEVNULL
    command = [str(BIN / "python"), "-m", "ik_node.control.compilation"]
    process = subprocess.Popen(command, cwd=ROOT, env=environment(), stdin=quiet, stdout=quiet, stderr=quiet)
    try:
        yield
    except BaseException:
        process.kill()
        raise


def make_small(prefix: Path) -> None:
    """Removes from an environment what is not read at run time; identical files become links, which wheels do not have.

    Each step can be repeated, and replaces no file in place: a process may be using it.
    """
    for path in [path for pattern in NOT_RUN for path in prefix.glob(pattern)]:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)  # also within a folder that was removed
        else:
            path.unlink(missing_ok=True)
    for robots in prefix.glob(f"{CMEEL}/share/example-robot-data/robots"):
        for path in unnamed_meshes(robots):
            path.unlink()
    if strip := shutil.which("strip"):
        for path in [path for pattern in WITH_SYMBOLS for path in prefix.glob(pattern)]:
            smaller = path.with_name(f"{path.name}.small")
            if path.is_symlink():
                continue
            done = subprocess.run([strip, "-o", smaller, path], stderr=subprocess.DEVNULL, check=False)
            if done.returncode == 0:
                smaller.replace(path)
    with contextlib.suppress(OSError):  # a file system without links
        link_identical_files(prefix)


def unnamed_meshes(folder: Path) -> list[Path]:
    """Meshes whose names occur in no description (URDF, SRDF, Xacro, ...) of the folder."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    meshes = [path for path in paths if path.suffix.lower()[1:] in MESHES]
    pictures = (".jpg", ".png")
    texts = (path.read_text(errors="replace") for path in paths if path not in meshes and path.suffix not in pictures)
    pattern = re.compile(rf"[^/\"'<>=\n]+\.(?:{'|'.join(MESHES)})", re.IGNORECASE)
    named = {unquote(name).lower() for text in texts for name in pattern.findall(text)}
    return [path for path in meshes if path.name.lower() not in named]


def link_identical_files(folder: Path) -> None:
    """Replaces all but one of identical files by hard links."""
    first: dict[tuple[int, int, str], Path] = {}
    for path in sorted(folder.rglob("*")):
        status = path.lstat()
        if path.is_symlink() or not path.is_file() or status.st_size < MIN_LINKED_BYTES:
            continue
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        one = first.setdefault((status.st_dev, status.st_mode, digest), path)
        if not one.samefile(path):
            link = path.with_name(f"{path.name}.link")
            link.unlink(missing_ok=True)
            os.link(one, link)
            link.replace(path)


def become(*command: str, python_path: Path | None = None) -> NoReturn:
    """Replace this process by an executable of the environment, in the caller's folder.

    A signal to this process, from a terminal or a supervisor, then reaches the node itself. A parent in between would
    have to wait for a ramp to zero of any length; ``subprocess.run`` kills its child 0.25 s after Ctrl-C.
    """
    variables = environment() if python_path is None else {**environment(), "PYTHONPATH": str(python_path)}
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(str(BIN / command[0]), [str(BIN / command[0]), *command[1:]], variables)


def test(options: list[str]) -> int:
    """Linters and type checks, of which the first failure ends it with its exit code; then becomes pytest.

    The functions that the tests call are compiled beside the type checks: in a new checkout each takes a minute.
    """
    os.chdir(ROOT)
    for check in (("ruff", "check", "."), ("ruff", "format", "--check", ".")):
        print("$", *check, flush=True)
        code = subprocess.run([str(BIN / check[0]), *check[1:]], env=environment(), check=False).returncode
        if code:
            return code
    print("$ ik_compile & mypy", flush=True)
    with subprocess.Popen([str(BIN / "ik_compile")], env=environment()):
        # Tests do without stored machine code, so the exit code of ik_compile does not end it.
        code = subprocess.run([str(BIN / "mypy")], env=environment(), check=False).returncode
    if code:
        return code
    # Before the caller's options, of which the last one counts: `-n 0` runs all of it in one process.
    command = ("pytest", "-n", "auto", "--dist", "worksteal", *options)
    print("$", *command, flush=True)
    become(*command)


def main() -> int:
    """Does what the first argument says."""
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        print(__doc__)
        return 0 if len(sys.argv) > 1 else 2
    task, options = sys.argv[1], sys.argv[2:]
    try:
        set_up([RUNTIME, TESTS] if task == "test" else [RUNTIME])
    except subprocess.CalledProcessError as error:
        sys.exit(f"error: setting up failed: {error}")
    if task == "test":
        return test(options)
    if task == "ik_benchmark":  # not installed: part of the checkout only
        become("python", "-m", "benchmarks", *options, python_path=ROOT)
    executable = "ik_demo" if task == "demo" else task
    if not (BIN / executable).exists():
        sys.exit(
            f"error: no executable '{executable}'; there are: {', '.join(sorted(p.name for p in BIN.glob('ik_*')))}"
        )
    become(executable, *options)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:  # while setting up, or in a check: no node runs
        sys.exit(130)

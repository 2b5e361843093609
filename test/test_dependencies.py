"""Numerical packages of different installations end an executable with one line, before anything is computed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import coal
import pytest
from support import PROJECT

from ik_node.dependencies import COMPILED, ROBOTICS, check

ANY_ROBOT = ("node", ("--ros-args", "-p", "robot:=panda"))
RECORDING = ("replay", (str(PROJECT / "bags" / "plain"),))


def run(extra_path: Path, module: str, arguments: tuple[str, ...]) -> subprocess.CompletedProcess[str]:
    """An executable with a folder before all others on the path, as PYTHONPATH of a ROS installation is."""
    path = os.pathsep.join((str(extra_path), str(PROJECT)))
    return subprocess.run(
        [sys.executable, "-m", f"ik_node.cli.{module}", *arguments],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_the_packages_of_this_environment_fit() -> None:
    check(COMPILED)
    check(ROBOTICS)


@pytest.mark.parametrize(("module", "arguments"), [ANY_ROBOT, RECORDING])
def test_a_scipy_built_for_another_numpy_ends_with_one_line(
    tmp_path: Path, module: str, arguments: tuple[str, ...]
) -> None:
    """The text is that of SciPy 1.11.4 with NumPy 2.5, of which test/jazzy has the real ones."""
    package = tmp_path / "scipy"
    package.mkdir()
    (package / "__init__.py").write_text('raise ValueError("numpy.dtype size changed, may indicate incompatibility")')
    ended = run(tmp_path, module, arguments)
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert ended.stderr.startswith("error: scipy ") and "numpy.dtype size changed" in ended.stderr
    assert str(tmp_path) in ended.stderr and "does not fit numpy " in ended.stderr and "docs/jazzy.md" in ended.stderr


@pytest.mark.parametrize(("module", "arguments"), [ANY_ROBOT, RECORDING])
def test_coal_of_another_installation_ends_with_one_line(
    tmp_path: Path, module: str, arguments: tuple[str, ...]
) -> None:
    package = tmp_path / "coal"
    package.mkdir()
    for path in Path(coal.__file__).parent.iterdir():
        if path.is_file():
            (package / path.name).write_bytes(path.read_bytes())
    ended = run(tmp_path, module, arguments)
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1, ended.stderr
    assert "are of two installations" in ended.stderr and str(tmp_path) in ended.stderr


def test_a_missing_package_is_named(tmp_path: Path) -> None:
    package = tmp_path / "numba"
    package.mkdir()
    (package / "__init__.py").write_text("import no_such_package")
    ended = run(tmp_path, *RECORDING)
    assert ended.returncode == 2
    assert ended.stderr.startswith("error: package no_such_package is missing; ") and ended.stderr.count("\n") == 1

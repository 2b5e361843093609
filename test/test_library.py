"""``import ik_node`` is light, has no side effects, and gives every exported name with its type."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from support import PROJECT

import ik_node
from ik_node.errors import EXTRAS, IkNodeError, MissingPackageError

if TYPE_CHECKING:
    # mypy warns about an unused comment: these lines fail when names have no types or when unknown names are accepted.
    _robot: str = ik_node.load_robot("panda")  # type: ignore[assignment]
    _solution: str = ik_node.solve_pose(ik_node.load_robot("panda"), ())  # type: ignore[assignment]
    _run: str = ik_node.load_run("bag")  # type: ignore[assignment]
    _unknown = ik_node.no_such_name  # type: ignore[attr-defined]

HEAVY = ("numpy", "numba", "pinocchio", "rclpy", "scipy", "matplotlib", "yaml", "mcap", "rosbags")


def python(code: str, home: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` in another process whose home and working folder are ``home``."""
    added = {"HOME": str(home), "PYTHONPATH": str(PROJECT), "PYTHONDONTWRITEBYTECODE": "1", **environment}
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=home, env={**kept, **added}, check=False
    )


def test_the_import_loads_no_other_package_and_writes_nothing(tmp_path: Path) -> None:
    code = f"""
import sys
before = set(sys.modules)
import ik_node
dir(ik_node)
print(sorted(name for name in set(sys.modules) - before if name.startswith("ik_node.")))
print([name for name in {HEAVY} if name in sys.modules and name not in before])
"""
    done = python(code, tmp_path)
    assert done.stdout.splitlines() == ["[]", "[]"], done.stderr
    assert list(tmp_path.iterdir()) == []


def test_every_exported_name_can_be_imported() -> None:
    assert len(set(ik_node.__all__)) == len(ik_node.__all__)
    for name in ik_node.__all__:
        value = getattr(ik_node, name)
        assert value is getattr(ik_node, name)
        assert name in dir(ik_node)
        module = sys.modules[getattr(value, "__module__", "builtins")]
        assert getattr(module, name, value) is value


def test_every_error_is_exported() -> None:
    errors = {name for name, value in vars(sys.modules["ik_node.errors"]).items() if isinstance(value, type)}
    exported = {name for name in ik_node.__all__ if getattr(ik_node, name).__class__ is type}
    assert {name for name in errors if name != "Iterable"} <= exported
    assert all(issubclass(getattr(ik_node, name), IkNodeError) for name in errors if name != "Iterable")


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        ik_node.no_such_name  # type: ignore[attr-defined]  # noqa: B018


def test_the_core_needs_no_package_of_an_extra(tmp_path: Path) -> None:
    """Kinematics and control work without the packages for recordings, pictures, the viewer and ROS."""
    code = f"""
import sys
sys.modules.update(dict.fromkeys({tuple(EXTRAS)}))
import ik_node
for name in ik_node.__all__:
    if name != "load_run":
        getattr(ik_node, name)
try:
    ik_node.load_run
except ik_node.MissingPackageError as error:
    print(error)
"""
    done = python(code, tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "numba"))
    assert done.returncode == 0, done.stderr
    assert "pip install 'ik_node[recording]'" in done.stdout


def test_each_extra_is_installable() -> None:
    setup = (PROJECT / "setup.py").read_text()
    for extra in set(EXTRAS.values()):
        assert f'"{extra}": ' in setup
    for package in EXTRAS:
        assert package in setup


@pytest.mark.parametrize(
    ("package", "hint"), [("viser", "ik_node[view]"), ("rclpy.node", "ROS 2"), ("nothing", "nothing")]
)
def test_a_missing_package_is_named_with_its_extra(package: str, hint: str) -> None:
    assert hint in str(MissingPackageError(ModuleNotFoundError(f"No module named '{package}'", name=package)))


def test_type_information_is_installed() -> None:
    assert (PROJECT / "ik_node" / "py.typed").is_file()
    assert 'package_data={NAME: ["py.typed"]}' in (PROJECT / "setup.py").read_text()

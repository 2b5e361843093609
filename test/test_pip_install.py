"""``pip install '.[report]'`` into an empty environment without ROS: the executables of the README run there.

It downloads some 500 MB and compiles for a minute, so it runs with ``--exhaustive``.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support import PROJECT
from waiting import ENOUGH_S

BUILT = shutil.ignore_patterns(".venv", ".git", "__pycache__", "build", "*.egg-info", "ik_demo_*")
POSE = "0.4 0.1 0.5 1 0 0 0"


class Environment:
    """A virtual environment with the package, and an empty home and working folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "work"
        self.folder.mkdir()
        kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG") or "PIP" in name}
        kept |= {name: value for name, value in os.environ.items() if name.lower().endswith("_proxy")}
        # The pip configuration of the machine applies; Python finds nothing of this checkout.
        self._environment = {
            **kept,
            "HOME": os.environ.get("HOME", str(folder)),
            "XDG_CACHE_HOME": str(folder / "cache"),
        }
        self._venv = folder / "venv"
        sources = folder / "sources"
        shutil.copytree(PROJECT, sources, ignore=BUILT)
        self.run(sys.executable, "-m", "venv", str(self._venv))
        self.run(str(self._venv / "bin" / "pip"), "install", "--quiet", f"{sources}[report]")

    def run(self, *command: str) -> str:
        done = subprocess.run(
            command,
            cwd=self.folder,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=ENOUGH_S,
            check=False,
        )
        assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
        return done.stdout

    def ik(self, name: str, *arguments: str) -> str:
        return self.run(str(self._venv / "bin" / name), *arguments)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return Environment(tmp_path_factory.mktemp("pip"))


@pytest.mark.exhaustive
def test_the_executables_run_without_ros(installed: Environment) -> None:
    probe = "import importlib.util as u, ik_node; print(u.find_spec('rclpy'), ik_node.__file__)"
    found = installed.ik("python", "-c", probe)
    assert found.startswith("None "), "this environment has ROS"
    assert str(PROJECT) not in found, "the package of the checkout is imported"

    assert "converged" in installed.ik("ik_solve", "--robot", "panda", "--target", POSE)
    said = installed.ik("ik_demo", "--no-ros", "--headless", "--out", "run")
    assert said.count("Tracked to") == 1
    assert (installed.folder / "run" / "report.png").is_file()
    assert "identical" in installed.ik("ik_replay", "run/bag")
    installed.ik("ik_report", "run/bag", "--html", "--out", "run.html")
    assert (installed.folder / "run.html").stat().st_size > 10_000
    assert json.loads(installed.ik("ik_report", "run/bag", "--json"))["speed"]["over_limit"] == 0
    compared = installed.ik("ik_replay", "run/bag", "--method", "all", "--report", "methods.png")
    assert "null-space speed" in compared
    assert "rate_hz" in installed.ik("ik_config", str(PROJECT / "test" / "lift_arm.urdf"))


@pytest.mark.exhaustive
def test_what_needs_ros_says_so_in_one_line(installed: Environment) -> None:
    with pytest.raises(AssertionError, match=r"error: .*rclpy.*--no-ros"):
        installed.ik("ik_demo", "--headless", "--out", "other")
    assert not (installed.folder / "other").exists()

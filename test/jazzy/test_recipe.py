"""The README's lines for a ROS 2 Jazzy installation, followed in a stand-in for Ubuntu 24.04."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
from standin import build, clean_environment, python312
from support import PROJECT

NUMERICAL = ("numpy", "scipy", "numba", "pin", "coal", "daqp", "example-robot-data", "mcap")
RUN = ". {ros}/setup.bash && . {home}/ws/install/setup.bash && "
EXECUTABLES = "{home}/ws/install/ik_node/lib/ik_node"


def recipe() -> list[str]:
    """The lines of the README."""
    found = re.search(
        r"<!-- test/jazzy runs these lines -->\n```sh\n(.*?)```", (PROJECT / "README.md").read_text(), re.S
    )
    assert found is not None
    return found.group(1).splitlines()


def test_rosdep_installs_no_numerical_package() -> None:
    """ROS packages precede the virtual environment on PYTHONPATH."""
    keys = {element.text or "" for element in ElementTree.parse(PROJECT / "package.xml").iter("exec_depend")}
    assert "rclpy" in keys
    assert not [key for key in keys if re.search("numpy|scipy|numba|pinocchio|coal|matplotlib|eigenpy", key)]


def test_the_recipe_installs_every_pinned_package_but_those_of_ros() -> None:
    line = next(line for line in recipe() if line.startswith("grep "))
    command = line.rpartition(" | ")[0]
    kept = subprocess.run(
        ["bash", "-c", command.replace("src/ik_node", shlex.quote(str(PROJECT)))],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    names = {re.split("[=<>; ]", each)[0] for each in kept.splitlines() if each and not each.startswith("#")}
    assert names >= set(NUMERICAL)
    assert not [name for name in names if name.startswith("ros-")]


@pytest.mark.exhaustive
def test_the_recipe_in_a_stand_in_for_ubuntu(tmp_path: Path) -> None:
    """Demo, node and replay; a SciPy built for another NumPy ends with one line."""
    python = python312()
    if python is None:
        pytest.skip("needs a Python 3.12 outside /usr")
    system, ros = build(tmp_path, python)
    home = tmp_path / "home"
    home.mkdir()
    environment = clean_environment(system, home)

    def bash(script: str, code: int = 0) -> str:
        done = subprocess.run(
            ["bash", "-e", "-c", script], env=environment, capture_output=True, text=True, check=False, cwd=home
        )
        assert done.returncode == code, f"{script}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout + done.stderr

    assert "externally-managed" in bash("pip install daqp", 1)
    lines = [
        line.replace("/opt/ros/jazzy", str(ros)).replace("<this repository>", str(PROJECT))
        for line in recipe()
        if not line.startswith(("rosdep ", "ros2 launch "))  # neither is on the package index
    ]
    assert len(lines) == 5
    bash("\n".join(lines))
    begin, folder = RUN.format(ros=ros, home=home), EXECUTABLES.format(home=home)
    assert Path(f"{folder}/ik_node").read_text().startswith(f"#!{home}/ws/venv/bin/python")
    assert "mm" in bash(f"{begin}{folder}/ik_demo --out {home}/run")
    assert "bit for bit" in bash(f"{begin}{folder}/ik_replay {home}/run/bag")
    node = bash(f"{begin}timeout --preserve-status -s INT 60 {folder}/ik_node --ros-args -p robot:=panda")
    assert "configured: panda_link0 -> panda_hand_tcp" in node
    only_scipy = home / "only_scipy"
    only_scipy.mkdir()
    for name in ("scipy", "scipy.libs"):
        (only_scipy / name).symlink_to(system / "lib" / "python3.12" / "site-packages" / name)
    misfit = bash(f"{begin}PYTHONPATH={only_scipy}:$PYTHONPATH {folder}/ik_replay {home}/run/bag", 2)
    assert len(misfit.splitlines()) == 1
    assert "scipy 1.11.4" in misfit and "does not fit numpy 2" in misfit and "docs/jazzy.md" in misfit

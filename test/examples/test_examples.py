"""The scripts in examples/ run, and their output has the properties that they demonstrate."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support import PROJECT

import ik_node

EXAMPLES = PROJECT / "examples"
NUMBER = r"[-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?"
Printed = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def output(name: str, capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.setattr(sys, "argv", [name])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out.splitlines()


def numbers(line: str) -> list[float]:
    return [float(text) for text in re.findall(rf"(?<![\w.]){NUMBER}", line)]


def test_one_pose_is_reached_within_the_limits(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    first, *joints, last = output("ik_one_pose.py", capsys, monkeypatch)
    assert first.startswith("converged: True")
    assert len(joints) == 7
    for line in joints:
        q, lower, upper = numbers(line)
        assert lower <= q <= upper
    assert numbers(last)[0] < 1e-5


def test_each_pseudoinverse_has_the_least_of_its_own_cost(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    _, *lines = output("three_pseudoinverses.py", capsys, monkeypatch)
    rows = {line.split()[0]: numbers(line) for line in lines}
    assert list(rows) == ["plain", "inertia_weighted", "gravity_gradient"]
    norms, energies, powers, errors = (
        dict(zip(rows, column, strict=True)) for column in zip(*rows.values(), strict=True)
    )
    assert min(norms, key=norms.__getitem__) == "plain"
    assert min(energies, key=energies.__getitem__) == "inertia_weighted"
    assert min(powers, key=powers.__getitem__) == "gravity_gradient"
    assert max(errors.values()) < 1e-12


def test_the_gradient_keeps_its_distance_in_closed_loop(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = output("closed_loop_obstacle.py", capsys, monkeypatch)
    without, with_gradient = (numbers(line)[0] for line in lines)
    assert with_gradient > without > 0.0
    assert Path("closed_loop_obstacle.png").read_bytes().startswith(b"\x89PNG")


def test_a_recording_becomes_arrays(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = output("read_recording.py", capsys, monkeypatch)
    run = ik_node.load_run(PROJECT / "bags" / "limit")
    steps, joints = run.q.shape
    assert numbers(lines[0])[0] == steps
    assert lines[1].endswith(f"({steps}, {joints})")
    assert "velocity" in "".join(lines) or "position" in "".join(lines)
    assert any("tracking" in line for line in lines)


def test_a_urdf_of_ones_own_has_the_kinematics_of_the_formula(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = output("own_urdf.py", capsys, monkeypatch)
    place = numbers(lines[1])
    assert place[:2] == pytest.approx(place[2:], abs=1e-7)
    rows = np.array([numbers(line) for line in lines[3:6]])
    qd = numbers(lines[6].partition(":")[2])
    assert rows[:2] @ qd == pytest.approx((0.1, 0.0), abs=1e-5)


@pytest.mark.parametrize(
    ("name", "better"),
    [("joint_limits", lambda plain, own: own > 1.5 * plain), ("camera_view", lambda plain, own: own < 0.5 * plain),
     ("manipulability", lambda plain, own: own > 1.05 * plain)],
)  # fmt: skip
def test_an_own_method_improves_its_aim_and_not_the_error_of_the_task(
    name: str, better: Callable[[float, float], bool], capsys: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The smallest distance from a joint limit, the angle to the object in view, the manipulability."""
    plain, own = (numbers(line) for line in output(f"own_method_{name}.py", capsys, monkeypatch))
    assert better(plain[0], own[0])
    assert max(plain[1], own[1]) < 0.1, "mm"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_examples_are_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 50

"""docs/task.md is correct: its Python runs, its command converges, its tolerances are valid, the functions that it
names exist, and the table of ranks has the computed numbers."""

from __future__ import annotations

import importlib
import re
import shlex
from typing import Any

import pytest
from support import PROJECT

from ik_node.cli import solve
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.robot.catalogue import load_robot
from ik_node.robot.task_rank import task_rank

PAGE = PROJECT / "docs" / "task.md"
TEXT = PAGE.read_text(encoding="utf-8")
NUMBERS = r"((?:(?:\d[\d.]*|inf) ){5}(?:\d[\d.]*|inf))"
ARMS = re.findall(rf"^\| (\w+) \| (\d) \| (.*?) \| ([\d.]+) \| (?:{NUMBERS}(?: in `(\w+)`)?)? ?\|$", TEXT, re.MULTILINE)


def tolerance(text: str, frame: str = "tool") -> TaskTolerance:
    return TaskTolerance([float(word) for word in text.split()], frame)


def test_the_python_reaches_the_pose() -> None:
    session: dict[str, Any] = {}
    (body,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    exec(compile(body, str(PAGE), "exec"), session)
    assert session["solution"].converged
    assert not session["ik_node"].solve_pose(session["robot"], session["pose_sd"], restarts=20).converged


def test_the_commands_converge_and_the_hint_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    (body,) = re.findall(r"^```sh\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    program, *arguments = shlex.split(body)
    assert program == "ik_solve"
    assert solve.main(arguments) == 0
    capsys.readouterr()
    whole = arguments[: arguments.index("--tolerance")]
    assert solve.main([*whole, "--max-iterations", "100"]) == 1
    (hint,) = re.findall(r"^```text\n(hint: .*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    assert capsys.readouterr().err.split() == hint.split()


def test_the_tolerances_are_valid() -> None:
    rows = re.findall(rf"^\| .* \| {NUMBERS} \| (?:`(\w+)`|either) \|$", TEXT, re.MULTILINE)
    assert len(rows) == 6
    for numbers, frame in rows:
        assert not tolerance(numbers, frame or "tool").is_exact


@pytest.mark.parametrize("row", ARMS, ids=lambda row: f"{row[0]} {row[2]}")
def test_the_table_of_ranks_has_the_computed_numbers(row: tuple[str, ...]) -> None:
    name, joints, task, least, proposed, frame = row
    arm = load_robot(name)
    assert arm.n == int(joints)
    if ": " in task:
        numbers = re.search(rf"{NUMBERS} in `(\w+)`", task)
        assert numbers is not None
        chosen = tolerance(numbers[1], numbers[2])
    else:
        inf = float("inf")
        chosen = {
            "whole pose": TaskTolerance(),
            "position": TaskTolerance((0, 0, 0, inf, inf, inf)),
            "pointing": TaskTolerance((0, 0, 0, 0, 0, inf)),
        }[task]
    rank = task_rank(arm, chosen)
    assert rank.singular_values[-1] == pytest.approx(float(least), abs=6e-4)
    assert rank.proposal == (tolerance(proposed, frame or "tool") if proposed else None)


def test_the_table_of_ranks_is_read() -> None:
    assert len(ARMS) == 7


def test_functions_named_exist() -> None:
    names = set(re.findall(r"`(ik_node(?:\.\w+)+)[(`]", TEXT))
    assert len(names) >= 2
    for name in sorted(names):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name

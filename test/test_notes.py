"""The documents are correct: code and commands of docs/notes.md print the output shown there, the functions and tests
named there exist, and the Python of README.md runs."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
import shlex
from typing import Any

import numpy as np
import pytest
from support import PROJECT

from ik_node.cli import solve

PAGE = PROJECT / "docs" / "notes.md"
TEXT = PAGE.read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(python|console|text)\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)


@np.printoptions()  # the page changes them
def test_code_prints_what_the_page_says() -> None:
    # The blocks run in one session, in order; a `text` block is the output of the code before it.
    session: dict[str, Any] = {}
    printed: str | None = None
    compared = 0
    for kind, body in BLOCKS:
        if kind == "python":
            assert not printed, f"the page lacks this output: {printed}"
            with contextlib.redirect_stdout(io.StringIO()) as output:
                exec(compile(body, str(PAGE), "exec"), session)
            printed = output.getvalue()
        elif kind == "text":
            assert printed == body
            printed = None
            compared += 1
    assert not printed
    assert compared >= 20


@pytest.mark.parametrize("body", [body for kind, body in BLOCKS if kind == "console"])
def test_commands_print_what_the_page_says(body: str, capsys: pytest.CaptureFixture[str]) -> None:
    command, _, expected = body.partition("\n")
    program, *arguments = shlex.split(command.removeprefix("$ "))
    assert program == "ik_solve"
    assert solve.main(arguments) == 0
    assert capsys.readouterr().out == expected


def test_functions_named_exist() -> None:
    names = set(re.findall(r"`(ik_node(?:\.\w+)+)`", TEXT))
    assert len(names) > 10
    for name in sorted(names):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name


def test_tests_named_exist() -> None:
    names = set(re.findall(r"`(test_\w+\.py)::(test_\w+)`", TEXT))
    assert len(names) > 20
    files = {path.name: path for path in (PROJECT / "test").rglob("test_*.py")}
    for file, function in sorted(names):
        assert f"def {function}(" in files[file].read_text(encoding="utf-8"), f"{file}::{function}"


def test_every_exercise_has_its_place() -> None:
    for number in ("6.3", "6.4", "6.5", "6.6", "6.8", "6.9", "6.10", "6.11", "6.12 and 6.13", "7.15"):
        assert re.search(rf"^### {re.escape(number)}\b", TEXT, re.MULTILINE), number


def test_the_code_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(PROJECT)  # it reads a recording of bags/
    blocks = re.findall(r"^```python\n(.*?)^```$", (PROJECT / "README.md").read_text(), re.DOTALL | re.MULTILINE)
    assert blocks
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
    assert "nan" not in capsys.readouterr().out

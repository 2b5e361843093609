"""Every command ends without an error message when the reader of its output closes the pipe; other broken pipes remain
errors."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys

import pytest
from support import PROJECT

from ik_node.cli.entry import CLOSED_OUTPUT, command_line

NAMES = sorted(
    path.stem
    for path in (PROJECT / "ik_node" / "cli").glob("*.py")
    if "\ndef main(" in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("buffering", ["", "1"], ids=["buffered", "unbuffered"])
@pytest.mark.parametrize("command", ["report --help", "report bags/limit --json", "solve --example plateau"])
def test_an_unread_output_leaves_no_traceback(command: str, buffering: str) -> None:
    name, *arguments = command.split()
    reading, writing = os.pipe()
    os.close(reading)  # the pipe has no reader from the start: the worst case of `| head`
    try:
        done = subprocess.run(
            [sys.executable, "-m", f"ik_node.cli.{name}", *arguments],
            stdout=writing,
            stderr=subprocess.PIPE,
            text=True,
            cwd=PROJECT,
            env={**os.environ, "PYTHONUNBUFFERED": buffering},
            timeout=300,
            check=False,
        )
    finally:
        os.close(writing)
    assert done.stderr == ""
    swallowed = "--help" in arguments and buffering  # some versions of argparse ignore the error themselves
    assert done.returncode == CLOSED_OUTPUT or (swallowed and done.returncode == 0)


@pytest.mark.parametrize("name", NAMES)
def test_every_main_is_such_a_command_line(name: str) -> None:
    main = importlib.import_module(f"ik_node.cli.{name}").main
    assert main.__code__ is command_line(lambda arguments: 0).__code__


def test_there_are_command_lines() -> None:
    assert {"report", "node", "replay"} <= set(NAMES)


def test_the_broken_pipe_of_something_else_is_no_unread_output() -> None:
    @command_line
    def main(arguments: object = None) -> int:
        raise BrokenPipeError("a connection of our own")

    with pytest.raises(BrokenPipeError, match="of our own"):
        main([])


def test_what_main_returns_is_handed_on() -> None:
    assert command_line(lambda arguments: 3)([]) == 3

"""Runs of the benchmarks through their command line, in processes of their own or in one that is used again."""

from __future__ import annotations

import json
import os
import runpy
import subprocess
import sys
import tempfile
import traceback
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from typing import Any, NamedTuple

from support import PROJECT

LIMIT_S = 3600.0
"""Time-out for the largest benchmark on a busy machine."""


class Ran(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    def rows(self) -> list[dict[str, Any]]:
        """The output as one JSON object per line."""
        return [json.loads(line) for line in self.out.splitlines()]

    def document(self) -> dict[str, Any]:
        """The output as one JSON object."""
        document: dict[str, Any] = json.loads(self.out)
        return document


def started_benchmark(*arguments: str) -> Ran:
    """Run `ik_benchmark` with these arguments in a process of its own, for those that start other processes."""
    command = [sys.executable, "-m", "benchmarks", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    return _checked(Ran(done.returncode, done.stdout, done.stderr))


def benchmark(*arguments: str) -> Ran:
    """Run `ik_benchmark` with these arguments; tests do not check the speeds that it prints.

    All runs of a test process share a second process, which loads modules and machine code once.
    """
    return _checked(_runner().submit(_run, arguments).result(LIMIT_S))


def _checked(ran: Ran) -> Ran:
    assert "Traceback" not in ran.err, ran.err
    return ran


@cache
def _runner() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_find_benchmarks)


def _find_benchmarks() -> None:
    """The benchmarks are not installed; `python -m` finds them in the current folder."""
    sys.path.insert(0, str(PROJECT))


def _run(arguments: tuple[str, ...]) -> Ran:
    """Run the module as `python -m benchmarks` does, with its output in files."""
    kept = [os.dup(number) for number in (1, 2)]
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        sys.argv = ["ik_benchmark", *arguments]
        try:
            runpy.run_module("benchmarks", run_name="__main__")
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        except Exception:  # as the interpreter does for a process of its own
            traceback.print_exc()
            code = 1
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for number, descriptor in zip((1, 2), kept, strict=True):
                os.dup2(descriptor, number)
                os.close(descriptor)
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode())
    return Ran(code, *texts)

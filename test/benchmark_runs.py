"""Runs of the benchmarks through their command line."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any, NamedTuple

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


def benchmark(*arguments: str) -> Ran:
    """Run `ik_benchmark` with these arguments; tests do not check the speeds that it prints."""
    command = [sys.executable, "-m", "benchmarks", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return Ran(done.returncode, done.stdout, done.stderr)

"""Runs of a benchmark as a person starts it."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any, NamedTuple

LIMIT_S = 3600.0
"""For the largest of them on a busy machine."""


class Ran(NamedTuple):
    """What came of a command."""

    code: int
    out: str
    err: str

    def rows(self) -> list[dict[str, Any]]:
        """One JSON object a line."""
        return [json.loads(line) for line in self.out.splitlines()]

    def document(self) -> dict[str, Any]:
        """One JSON object in all."""
        document: dict[str, Any] = json.loads(self.out)
        return document


def benchmark(*arguments: str) -> Ran:
    """`ik_benchmark` with these arguments; whatever it says of speed is not to be looked at."""
    command = [sys.executable, "-m", "benchmarks", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert "Traceback" not in done.stderr, done.stderr
    return Ran(done.returncode, done.stdout, done.stderr)

"""Runs an executable of the package as a process of its own and judges how it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence

from waiting import ENOUGH_S


def one_line(arguments: Sequence[str], text: str, good: Sequence[int] = (0,)) -> tuple[str, str, str]:
    """Run ``python -m ik_node.cli.NAME arguments``.

    Args:
        arguments: Name of the executable without ``ik_``, and its arguments.
        text: Part of the error, which has to be one line, with exit code 2; empty when the input has to be taken.
        good: Exit codes of an input that is taken.

    Returns:
        The last line, the exit code as text, and what is wrong; empty when all is right.
    """
    command = [sys.executable, "-m", f"ik_node.cli.{arguments[0]}", *arguments[1:]]
    try:
        process = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=ENOUGH_S, check=False, env=os.environ
        )
    except subprocess.TimeoutExpired:
        return "", "none", f"still running after {ENOUGH_S:g} s"
    lines = (process.stderr if text else process.stdout + process.stderr).strip().splitlines()
    last, code = lines[-1] if lines else "", process.returncode
    wrong = []
    if "Traceback" in process.stderr:
        wrong.append("a traceback")
    if code not in (good if not text else (2,)):
        wrong.append(f"exit code {code}")
    if text and (len(lines) != 1 or text not in last):
        wrong.append(f"{len(lines)} lines, expected one with '{text}'")
    return last, f"exit {code}", "; ".join(wrong)

"""Reading a recording does not import the numerical libraries of the controller: tools that only display or convert
recordings start quickly and run where Pinocchio is not installed."""

from __future__ import annotations

import os
import subprocess
import sys

from support import PROJECT

SCRIPT = """
import sys
from ik_node.recording.run_reader import load_run
from ik_node.recording.call_log import RecordedCalls
run = load_run(sys.argv[1])
calls = sum(hasattr(entry, "call") for entry in RecordedCalls(sys.argv[1]).entries())
print(len(run.tick), calls, *(name for name in ("numba", "pinocchio", "coal", "rclpy") if name in sys.modules))
"""


def test_a_recording_is_read_without_numba_and_pinocchio() -> None:
    command = [sys.executable, "-c", SCRIPT, str(PROJECT / "bags" / "plain")]
    environment = {**os.environ, "PYTHONPATH": str(PROJECT)}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    steps, calls, *loaded = done.stdout.split()
    assert loaded == []
    assert 100 < int(steps) < int(calls)

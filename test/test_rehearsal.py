"""Nothing is compiled while an arm moves: after a rehearsal, recorded runs of every kind find everything compiled.

Each run has a process of its own: what another run or test has compiled would hide what this one lacks.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from support import PROJECT

BAGS = sorted(path.parent for path in (PROJECT / "bags").glob("*/metadata.yaml"))
PROGRAM = """
import sys
from ik_node.compiled import compilations
from ik_node.recording.events import RecordedCalls
from ik_node.rehearsal import rehearse
from ik_node.replay.same import replay

bag = RecordedCalls(sys.argv[1])
rehearsed = rehearse(bag.robot(), bag.head.settings)
before = compilations()
ticks = replay(bag).ticks
print(rehearsed, ticks, compilations() - before)
"""


@pytest.mark.parametrize("bag", BAGS, ids=lambda path: path.name)
def test_a_recorded_run_finds_everything_compiled(bag: Path) -> None:
    command = [sys.executable, "-c", PROGRAM, str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    rehearsed, ticks, late = map(int, done.stdout.split())
    assert rehearsed > 0
    assert ticks > 0
    assert late == 0

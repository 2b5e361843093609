"""Regression suite: the controller reproduces every recording in bags/. A recording becomes a test case when its folder
is placed there (see bags/README.md). On other processors, or after code changes that affect rounding only, numbers may
differ by rounding."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from support import PROJECT, Run

from ik_node.recording.run_reader import load_run
from ik_node.replay import text
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource

FOLDER = PROJECT / "bags"
BAGS = sorted(path.parent for path in FOLDER.glob("*/metadata.yaml"))
LARGEST_MB = 3.0


@pytest.mark.parametrize("path", BAGS, ids=lambda path: path.name)
def test_the_recording_comes_out_as_it_is(in_own_process: Run, path: Path) -> None:
    """Distances depend on the collision geometries that a process has built before, in their last digits."""
    in_own_process(check_replay, path)


def check_replay(path: Path) -> None:
    recorded = RecordingSource(path)
    found = replay(recorded)
    assert found.passed, "\n" + text.as_text(recorded, found, 1.0)
    assert (found.missing_calls, found.skipped_calls) == (0, 0)


def test_every_case_of_the_script_is_there() -> None:
    """An empty folder would make every test pass."""
    sys.path.insert(0, str(FOLDER))
    try:
        from remake import CASES
    finally:
        sys.path.remove(str(FOLDER))
    missing = set(CASES) - {path.name for path in BAGS}
    assert not missing, f"python bags/remake.py {' '.join(sorted(missing))}"


def test_the_script_records_no_path_of_its_machine() -> None:
    """Parameters are recorded as they are given."""
    sys.path.insert(0, str(FOLDER))
    try:
        from remake import CASES, arguments_of
    finally:
        sys.path.remove(str(FOLDER))
    for name, case in CASES.items():
        assert not [argument for argument in arguments_of(case) if "/" in argument], name


def test_the_recordings_stay_small() -> None:
    size = sum(path.stat().st_size for path in FOLDER.rglob("*") if path.is_file())
    assert size < LARGEST_MB * 1e6


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("singularity", "singularity"),
        ("limit", "limits"),
        ("gaps", "stream has ended"),
    ],
)
def test_the_recordings_hold_what_they_are_for(name: str, words: str) -> None:
    run = load_run(FOLDER / name)
    assert any(words in change.status.reason for change in run.status_changes)
    assert run.complete
    assert run.dropped == 0

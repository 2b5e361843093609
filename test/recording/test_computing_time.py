"""A recording holds the computing time of its Steps, and whether its arm was simulated."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from loop import READY, Loop, make_robot
from recorded_loop import finish, record, recorded_loop

from ik_node.messages.decode import SIMULATED_ARM, is_simulated
from ik_node.messages.encode import encode_joint_state
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.report import compute_metrics
from ik_node.settings.groups import Settings


def test_the_computing_time_is_recorded_and_the_run_replays(tmp_path: Path) -> None:
    """With a clock that advances 0.25 ms per reading."""
    loop = Loop(make_robot("panda"), READY["panda"], Settings().with_values({"rate_hz": 100.0}))
    times_ns = itertools.count(0, 250_000)
    record(loop, tmp_path / "bag", timer_ns=lambda: next(times_ns))
    loop.run(0.3)
    finish(loop)
    run = load_run(tmp_path / "bag")
    assert run.computing_s == pytest.approx(np.full(len(run.tick), 250e-6))
    computing = compute_metrics(run).computing
    assert [computing.median_ms, computing.max_ms] == pytest.approx([0.25, 0.25])
    assert replay(RecordingSource(tmp_path / "bag")).identical


def test_a_run_without_a_clock_has_no_computing_time_and_names_its_arm(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0})
    loop.run(0.2)
    finish(loop)
    run = load_run(tmp_path / "bag")
    assert np.isnan(run.computing_s).all()
    assert run.simulated


def test_the_source_of_a_joint_state_is_in_its_header() -> None:
    position = np.zeros(2)
    assert is_simulated(encode_joint_state(("a", "b"), 1, position, frame_id=SIMULATED_ARM))
    assert not is_simulated(encode_joint_state(("a", "b"), 1, position))
    assert not is_simulated(b"none")

"""Late and lost targets, late steps and hold-ups of a recorded run: the report repeats the counts of the node."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded_loop import finish
from timed_loop import TimedLoop

from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.report import as_json, as_text, compute_metrics
from ik_node.report.lateness import hold_ups, target_age_s
from ik_node.report.reported_run import report_run
from ik_node.report.table import metric_rows


def recorded(path: Path, what: Callable[[TimedLoop], None]) -> tuple[Run, dict[str, int]]:
    """A run of 1 s of quiet, ``what``, and 0.5 s of quiet; and the counts of its controller."""
    loop = TimedLoop(path)
    loop.run(1000)
    what(loop)
    loop.run(500)
    counts = loop.loop.controller.counts
    finish(loop.loop)
    return load_run(path), counts


def disturbed(loop: TimedLoop) -> None:
    """Three hold-ups, a silent driver, 3 of 25 targets lost."""
    for duration_ms in (20, 30, 60):
        loop.hold_up(duration_ms)
        loop.run(100)
    loop.silent = True
    loop.run(25)
    loop.silent = False
    loop.run(100)
    first = loop.sent
    loop.is_lost = lambda number: number in (first + 2, first + 8, first + 9)
    loop.run(500)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lateness") / "bag"


@pytest.fixture(scope="module")
def run(bag: Path) -> tuple[Run, dict[str, int]]:
    return recorded(bag, disturbed)


def test_the_report_repeats_the_counts_of_the_node(run: tuple[Run, dict[str, int]]) -> None:
    metrics, counts = compute_metrics(run[0]), run[1]
    steps, targets = metrics.late_steps, metrics.late_targets
    assert (steps.hold_ups, round(1e3 * steps.hold_ups_s)) == (counts["hold_ups"], counts["hold_ups_ms"]) == (3, 110)
    assert metrics.targets == counts["targets"]
    assert (targets.late, targets.lost) == (counts["targets_late"], counts["targets_lost"])
    assert targets.lost == 3
    assert targets.late == 2, "of the hold-up of 60 ms, those older than a period"
    assert steps.late == counts["steps_late"] == 4
    assert steps.by_machine == 3
    assert steps.held_too_long == 4, "longer than 10 ms"
    assert steps.hold_up_max_ms == pytest.approx(60.0)
    assert hold_ups(run[0]).duration_s.tolist() == pytest.approx([0.02, 0.03, 0.06])


def test_a_disturbed_run_replays(run: tuple[Run, dict[str, int]], bag: Path) -> None:
    del run
    assert replay(RecordingSource(bag)).passed


def test_the_figures_are_in_text_json_and_table(run: tuple[Run, dict[str, int]]) -> None:
    metrics = compute_metrics(run[0])
    lines = as_text(metrics).splitlines()
    assert "late steps   4: 3 by this machine, 1 by late joint states" in lines
    assert "hold-ups     3, 0.11 s, max 60.0 ms; 4 commands held too long" in lines
    assert any(line.startswith("targets ") and line.endswith("; 2 late, 3 lost") for line in lines)
    plain = json.loads(as_json(metrics))
    assert plain["late_steps"]["hold_ups"] == 3
    assert plain["late_targets"]["age"]["max_ms"] == pytest.approx(metrics.late_targets.age.max_ms)
    rows = {row.label: row.values[0] for row in metric_rows([report_run(run[0], metrics)])}
    assert (rows["targets late"], rows["targets lost"], rows["hold-ups of the node"]) == ("2", "3", "3")


@pytest.mark.parametrize("transport_ms", [0, 15])
def test_the_age_of_the_target_includes_its_transport(tmp_path: Path, transport_ms: int) -> None:
    """Of a stream at 50 Hz the newest target is between 0 and 20 ms old, plus the transport."""

    def delayed(loop: TimedLoop) -> None:
        loop.transport_ms = transport_ms

    found, _ = recorded(tmp_path / "bag", delayed)
    ages = target_age_s(found)
    age = compute_metrics(found).late_targets.age
    assert np.isnan(ages[found.times_s < found.targets.times_s[0]]).all()
    assert age.max_ms == pytest.approx(20.0 + transport_ms, abs=2.1)
    settled = 1e3 * ages[(found.times_s > 1.1) & np.isfinite(ages)]
    assert settled.min() == pytest.approx(transport_ms, abs=1.1)
    assert np.median(settled) == pytest.approx(10.0 + transport_ms, abs=2.1)


def test_after_the_end_of_a_stream_the_target_has_no_age(tmp_path: Path) -> None:
    def ended(loop: TimedLoop) -> None:
        loop.is_lost = lambda number: True
        loop.run(800)

    found, _ = recorded(tmp_path / "bag", ended)
    ages, last_s = target_age_s(found), found.targets.times_s[-1]
    assert np.isnan(ages[found.times_s > last_s]).all()
    assert np.isfinite(ages[(found.times_s > 0.1) & (found.times_s < last_s)]).all()
    assert compute_metrics(found).late_targets.lost == 0

"""`ik_benchmark task` with short runs: the figures of this package, and the aims that they are compared with."""

from __future__ import annotations

import json
from pathlib import Path

from benchmark_runs import benchmark


def test_the_spin_of_the_target_changes_nothing(tmp_path: Path) -> None:
    """Pointing on a UR5, targets that spin at 0, 2 and 20 rad/s: same errors and settling time."""
    file = tmp_path / "task.json"
    ran = benchmark("task", "--only", "pointing", "--seconds", "1.5", "--ours", "--json", str(file))
    assert ran.code == 0
    document = json.loads(file.read_text())
    still, *spinning = (row for row in document["rows"] if row["candidate"] == "ik_node")
    assert [row["rate"] for row in spinning] == [2.0, 20.0]
    assert 0.1 < still["settling_s"] < 1.5
    assert still["largest_mm"] < 0.05
    assert still["largest_mrad"] < 0.05
    for row in spinning:
        assert row["settling_s"] == still["settling_s"]
        for name in ("rms_mm", "rms_mrad", "acceleration"):
            assert abs(row[name] - still[name]) < 1e-4
    assert {aim["name"] for aim in document["aims"]} == {
        "settling time, change by the spin",
        "time / whole pose, 10 %",
        "time / whole pose, median",
    }
    assert all(aim["met"] for aim in document["aims"] if aim["name"].startswith("settling"))
    assert "free part 20 rad/s" in ran.out


def test_the_command_refuses_runs_without_figures() -> None:
    ran = benchmark("task", "--seconds", "1")
    assert ran.code == 2
    assert "--seconds is 1; it has to be more than 1" in ran.err

"""`ik_benchmark tick`, `scale` and `latency` with short runs: the tables, and what is checked in the same run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmark_runs import benchmark, started_benchmark


def test_steps_agree_with_their_task_and_the_parts_add_up(tmp_path: Path) -> None:
    file = tmp_path / "tick.json"
    chosen = ("--robots", "ur5", "--steps", "120")
    ran = benchmark("tick", *chosen, "--cases", "free", "bound", "--obstacles", "0", "--ours", "--json", str(file))
    assert ran.code == 0
    rows = json.loads(file.read_text())["rows"]
    assert {row["candidate"] for row in rows} == {
        f"{method}{distances}" for method in ("plain", "inertia_weighted") for distances in ("", ", no distances")
    }
    for row in rows:
        assert 0.0 < row["p10_us"] <= row["median_us"] <= row["p99_us"]
        assert row["worst_residual"] < 1e-2
    parts = benchmark("tick", *chosen, "--parts")
    assert parts.code == 0
    assert parts.out.count("compiled step") == parts.out.count("    sum") == 5


def test_the_time_of_an_arm_is_printed_for_several() -> None:
    ran = started_benchmark("scale", "--steps", "30", "--arms", "2")
    assert "a process each" in ran.out
    assert ran.out.splitlines()[2].split()[0] == "2"


@pytest.mark.exhaustive
def test_every_joint_state_is_answered(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")
    file = tmp_path / "latency.json"
    started_benchmark("latency", "--rates", "50", "--seconds", "4", "--json", str(file))
    rows = json.loads(file.read_text())["rows"]
    assert [row["candidate"] for row in rows] == ["echo", "node", "node, recording"]
    for row in rows:
        assert row["sent"] == 200
        assert row["missed"] < 20  # a busy machine
        assert 0.0 < row["median_us"] < 20e3
        assert row["start_s"] > 0.1, "a process that imports rclpy"

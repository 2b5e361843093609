"""Benchmarks of recording and replay at a small size: they measure the stated quantities; the values are not tested."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmark_runs import benchmark, started_benchmark
from recorded_loop import finish, recorded_loop

from ik_node.settings.method_names import METHOD_NAMES
from ik_node.trajectory.shapes import figure_of_eight


def test_the_cost_of_recording_is_measured_in_turns() -> None:
    """Without recording, with the thread, with a process: the figures are plausible."""
    arguments = ("recording", "--only", "cost", "--rate", "200", "--seconds", "0.3", "--rounds", "2")
    found = started_benchmark(*arguments, "--json").document()["cost"]
    assert [part["mode"] for part in found] == ["off", "thread", "process"]
    for part in found:
        assert 0.0 < part["tick_us"][0] <= part["cycle_us"][0] <= part["cycle_us"][-1]
        assert part["tick_us"] == sorted(part["tick_us"])
    assert found[0]["mb_per_minute"] == found[0]["dropped"] == 0
    assert found[1]["mb_per_minute"] > 0.0
    assert found[2]["mb_per_minute"] > 0.0


def test_a_kill_is_measured_on_the_real_node() -> None:
    """The loss depends on the machine; the rest of the recording is complete and replays."""
    pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")
    found = started_benchmark("recording", "--only", "kills", "--kills", "1", "--json").document()["kills"]
    assert found["kills"] == found["whole_after"] == 1
    assert found["worst_s"] == found["median_s"] > 0.0


def test_replays_are_timed_and_compared(tmp_path: Path) -> None:
    """Of an existing recording."""
    loop = recorded_loop(tmp_path / "panda_plain" / "bag", {"rate_hz": 100.0, "obstacles.geometry": "none"})
    loop.follow(figure_of_eight(loop.pose()).pose, 1.0, 50.0)
    finish(loop)
    arguments = ("--robots", "panda", "--methods", "plain", "--keep", str(tmp_path), "--jobs", "1")
    ran = benchmark("replay", *arguments, "--json")
    assert ran.code == 0
    (found,) = ran.document()["same"]
    assert found["identical"]
    assert found["ticks"] == len(loop.steps)
    assert found["times_real_time"] == pytest.approx(found["duration_s"] / found["processor_s"])
    several = ran.document()["what_if"]
    assert several["runs"] == len(METHOD_NAMES)
    assert several["simulated_s"] == pytest.approx(len(METHOD_NAMES) * found["duration_s"])
    assert "bit for bit" in benchmark("replay", *arguments).out

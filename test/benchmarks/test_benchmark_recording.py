"""The measurements of recording and replay at a small size: that they measure what they say, not what comes out."""

from __future__ import annotations

from pathlib import Path

import pytest
from recorded_loop import finish, recorded_loop

from benchmarks import recording
from benchmarks import replay as replay_benchmark
from benchmarks.real_time_loop import ElsewhereRecording, PacedLoop
from ik_node.recording.call_log import RecordedCalls
from ik_node.replay.bitwise import replay
from ik_node.trajectory.shapes import figure_of_eight


def test_the_cost_of_recording_is_measured_in_turns(tmp_path: Path) -> None:
    found = recording.cost(tmp_path, 200.0, 0.3, 2)
    assert [part["mode"] for part in found] == ["off", "thread", "process"]
    for part in found:
        assert part["dropped"] == 0
        assert 0.0 < part["tick_us"][0] <= part["cycle_us"][0] <= part["cycle_us"][-1]
    assert found[0]["mb_per_minute"] == 0.0 < found[1]["mb_per_minute"]
    for directory in tmp_path.iterdir():
        again = replay(RecordedCalls(directory))
        assert again.identical
        assert 0 < again.ticks <= 60  # how many, the machine decides
    assert "dropped 0" in recording._text({"cost": found})


def test_the_process_beside_the_thread_writes_the_same(tmp_path: Path) -> None:
    loop = PacedLoop(200.0)
    written = ElsewhereRecording(tmp_path / "bag", loop.setup(), loop.now())
    loop.run(0.2, written)
    written.close()
    assert RecordedCalls(tmp_path / "bag").recording.complete


def test_a_kill_is_measured_on_the_real_node(tmp_path: Path) -> None:
    pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")
    found = recording.kills(tmp_path, 1)
    assert 0.0 < found["worst_s"] < recording.LOSS_ALLOWED_S
    assert found["whole_after"] == 1
    assert "1 kills" in recording._text({"kills": found})


def test_replays_are_timed_and_compared(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0, "obstacles.geometry": "none"})
    loop.follow(figure_of_eight(loop.pose()).pose, 1.0, 50.0)
    finish(loop)
    found = replay_benchmark.replayed(tmp_path / "bag")
    assert found["identical"]
    assert found["ticks"] == len(loop.steps)
    assert found["times_real_time"] == pytest.approx(found["duration_s"] / found["processor_s"])
    several = replay_benchmark.what_if(tmp_path / "bag", 1)
    assert several["runs"] == 4
    assert several["simulated_s"] == pytest.approx(4.0 * found["duration_s"])

"""``ik_demo --no-ros``: the same recording and report as over DDS, without rclpy, in simulated time."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support import PROJECT

from ik_node.cli import demo
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.report import compute_metrics
from ik_node.settings.method_names import METHOD_NAMES

WITHOUT_ROS = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("rclpy", "rcl_interfaces", "std_msgs", "sensor_msgs", "geometry_msgs"):
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
sys.meta_path.insert(0, Refuse())
from ik_node.cli.demo import main
sys.exit(main(sys.argv[1:]))
"""


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    """``ik_demo`` in a process in which ROS cannot be imported."""
    command = [sys.executable, "-c", WITHOUT_ROS, "--headless", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=600, check=False, cwd=PROJECT)


def test_the_demonstration_needs_no_ros(tmp_path: Path) -> None:
    done = run("--no-ros", "--out", str(tmp_path / "run"), "--trajectory", "circle")
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in (tmp_path / "run").iterdir()} == {
        "bag",
        "report.json",
        "report.png",
        "trajectory.csv",
    }
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["robot"] == "panda"
    assert report["tracking"]["settled"]["position_rms_mm"] < 0.1
    recorded = load_run(tmp_path / "run" / "bag")
    assert recorded.complete
    assert np.abs(recorded.joint_velocity).max() > 0.1
    assert np.all(recorded.computing_s > 0.0), "measured as by the node"
    assert report["computing"]["median_ms"] > 0.0
    assert replay(RecordingSource(tmp_path / "run" / "bag")).passed


@pytest.mark.parametrize("robot", ["so100", "so101"])
def test_a_small_arm_tracks_its_default_trajectory(robot: str, tmp_path: Path) -> None:
    """Its size is one with which the arm can follow it; arms of usual reach keep the full size."""
    assert demo.main(["--no-ros", "--headless", "--set", f"robot={robot}", "--out", str(tmp_path / "run")]) == 0
    report = json.loads((tmp_path / "run" / "report.json").read_text())
    assert report["trajectory"] == "figure_of_eight"
    assert report["tracking"]["settled"]["position_max_mm"] < 1.0
    path = load_run(tmp_path / "run" / "bag").pose_sd[:, :3, 3]
    assert 0.02 < np.ptp(path[:, 1]) < 0.25


def test_without_ros_the_error_names_the_option(tmp_path: Path) -> None:
    done = run("--out", str(tmp_path / "run"))
    assert done.returncode == 2
    assert "package rclpy is missing" in done.stderr
    assert "or give --no-ros" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "run").exists()


def test_the_same_options_give_the_same_bits_and_an_own_arm_moves(tmp_path: Path) -> None:
    own = ("--no-ros", "--headless", "--urdf", str(PROJECT / "test" / "lift_arm.urdf"), "--trajectory", "line")
    for name in ("first", "second"):
        assert demo.main([*own, "--out", str(tmp_path / name)]) == 0
    first, second = (load_run(tmp_path / name / "bag") for name in ("first", "second"))
    assert first.joint_velocity.tobytes() == second.joint_velocity.tobytes()
    assert np.abs(first.joint_velocity).max() > 0.05


def test_all_methods_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One recording per method of the same targets, a table and a picture."""
    own = ("--headless", "--trajectory", "hold", "--rate", "100", "--out", str(tmp_path / "run"), "--method", "all")
    assert demo.main(["--no-ros", *own]) == 0
    printed = capsys.readouterr().out
    assert all(label in printed for label in ("kinetic energy", "null-space speed", "gravitational energy", "λ task"))
    made = {path.name for path in (tmp_path / "run").iterdir()}
    assert made == {*METHOD_NAMES, "methods.png", "trajectory.csv"}
    recorded = [load_run(tmp_path / "run" / name) for name in METHOD_NAMES]
    assert [compute_metrics(run).method for run in recorded] == list(METHOD_NAMES)
    assert all(run.targets.position.tobytes() == recorded[0].targets.position.tobytes() for run in recorded)


def test_all_methods_need_no_ros_to_be_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert demo.main(["--headless", "--out", str(tmp_path / "run"), "--method", "all"]) == 2
    assert "--method all simulates each method in this process; expected --no-ros" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_noise_has_no_effect_and_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "noisy.yaml"
    section = "ros__parameters: {robot: panda"
    config.write_text(f"/**:\n  ik_node:\n    {section}}}\n  ik_simulator:\n    {section}, encoder_noise: 0.001}}\n")
    assert demo.main(["--no-ros", "--headless", "--config", str(config), "--out", str(tmp_path / "run")]) == 2
    assert "encoder_noise and dropout of ik_simulator have no effect with --no-ros" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()

"""Metrics of a run with a known offset and a known lag; stopped steps do not affect them.

The run is made by the controller and the simulated arm in one process and read from a recording.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from loop import make_robot
from recorded_loop import finish, recorded_loop

from ik_node.cli import report as command
from ik_node.errors import RecordingError, TrajectoryFileError
from ik_node.interfaces.clock import NS
from ik_node.math.se3 import quaternion_from_rotation
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.report import GroundTruth, as_json, as_text, compute_metrics, read_ground_truth, write_ground_truth
from ik_node.report.canvas import report_style
from ik_node.report.deviation import StatePeriod
from ik_node.report.reported_run import report_run
from ik_node.report.summary_page import draw_summary, save_summary
from ik_node.trajectory.shapes import figure_of_eight


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "bag"
    loop = recorded_loop(path, {"rate_hz": 200.0})
    loop.run(0.1)
    loop.follow(figure_of_eight(loop.pose()).pose, 4.0, 50.0)
    loop.controller.pause(loop.now, "paused by request")
    loop.run(0.5)
    finish(loop)
    return path


@pytest.fixture(scope="module")
def run(bag: Path) -> Run:
    return load_run(bag)


def measured_truth(run: Run, offset: tuple[float, float, float] = (0.0, 0.0, 0.0), lag_s: float = 0.0) -> GroundTruth:
    """The measured tool motion, shifted in position and time: a ground truth with known errors."""
    robot = make_robot("panda")
    rows = np.flatnonzero(np.isfinite(run.q).all(axis=1))
    poses = [robot.pose(q) for q in run.q[rows]]
    quaternions = np.array([quaternion_from_rotation(pose[:3, :3]) for pose in poses])
    signs = np.sign((quaternions[1:] * quaternions[:-1]).sum(axis=1))
    quaternions[1:] *= np.cumprod(signs)[:, None]
    positions = np.array([pose[:3, 3] for pose in poses]) + offset
    return GroundTruth(run.state_ros_ns[rows] - round(lag_s * NS), positions, quaternions)


def test_known_offset_is_measured(run: Run) -> None:
    metrics = compute_metrics(run, measured_truth(run, (0.003, 0.0, 0.004)), settle_s=0.0)
    assert metrics.tracking is not None
    assert metrics.tracking.overall.position_rms_mm == pytest.approx(5.0, rel=1e-3)
    assert metrics.tracking.overall.position_max_mm == pytest.approx(5.0, rel=1e-3)
    assert metrics.tracking.overall.orientation_max_mrad < 1e-3


def test_known_lag_is_measured_and_explains_the_error(run: Run) -> None:
    metrics = compute_metrics(run, measured_truth(run, lag_s=0.03), settle_s=0.0)
    assert metrics.tracking is not None
    assert metrics.tracking.lag_position_ms == pytest.approx(30.0, abs=1.0)
    assert metrics.tracking.overall.position_rms_mm > 0.3
    assert metrics.tracking.position_rms_without_lag_mm < 0.05


def test_metrics_agree_with_the_arrays(run: Run) -> None:
    metrics = compute_metrics(run)
    assert metrics.ticks.number == len(run.tick)
    parts = np.abs(run.joint_velocity) / run.velocity_limits
    assert metrics.speed.part_of_limit == pytest.approx(np.nanmax(parts))
    assert metrics.speed.non_finite == metrics.speed.over_limit == 0
    assert metrics.nearness.least == np.nanmin(run.clearance)
    assert metrics.singularity.least == pytest.approx(np.nanmin(run.singular_values[:, -1]))


def test_commands_over_a_limit_or_not_finite_are_counted(run: Run) -> None:
    commands = run.joint_velocity.copy()
    commands[5, 0], commands[7, 2] = np.nan, 99.0
    metrics = compute_metrics(run.with_columns(joint_velocity=commands))
    assert (metrics.speed.non_finite, metrics.speed.over_limit) == (1, 1)


def test_text_fits_a_screen_and_json_is_complete(run: Run) -> None:
    metrics = compute_metrics(run, measured_truth(run), "line")
    lines = as_text(metrics).splitlines()
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("Tracked to less than 0.001 mm RMS; ")
    assert lines[1].startswith("panda, line, method plain, ")
    read = json.loads(as_json(metrics))
    assert read["tracking"]["overall"]["position_max_mm"] < 0.01
    assert "series" not in read


def test_motion_off_the_direction_is_reported_with_its_limit(run: Run) -> None:
    """Ten steps with 10 mm/s off a twist of 100 mm/s, due to one limit, and one with 0.5 mm/s, which does not count."""
    off, twist, scale = np.zeros((len(run.tick), 6)), np.zeros((len(run.tick), 6)), np.ones(len(run.tick))
    twist[:, 0], scale[:100] = 0.1, 0.75
    off[50:60, 1], off[80, 1] = 0.01, 0.0005
    limits: list[tuple[str, ...]] = [()] * len(run.tick)
    limits[50:60] = [("acceleration panda_joint2", "velocity panda_joint4")] * 10
    changed = run.with_columns(off_direction_b=off, twist_b=twist, truncated_b=0.0 * twist, scale=scale)
    changed = changed._replace(texts={**run.texts, "off_direction_limits": tuple(limits)})
    direction = compute_metrics(changed).direction
    assert direction.off_linear_max == pytest.approx(0.01)
    assert direction.held_back_linear_max == pytest.approx(0.025)
    assert direction.off_angular_max == 0.0
    assert direction.off_s == pytest.approx(0.05, rel=0.2)
    assert direction.limits == (("acceleration panda_joint2", direction.off_s),)
    line = next(line for line in as_text(compute_metrics(changed)).splitlines() if line.startswith("direction"))
    assert line.startswith("direction    off 0.05 s, max 10.0 mm/s, 0.0 mrad/s; acceleration panda_joint2")
    assert "direction" not in as_text(compute_metrics(run))
    read = json.loads(as_json(compute_metrics(changed)))
    assert read["direction"]["limits"][0][0] == "acceleration panda_joint2"


def test_a_stream_that_is_too_fast_is_reported_with_the_parameter(run: Run, tmp_path: Path) -> None:
    """A line at up to 1.6 m/s, faster than the reference may be; and the snapshots replay."""
    assert compute_metrics(run).target_too_fast.text == ""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0})
    loop.run(0.1)
    start = loop.pose()

    def pose(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[1, 3] += 0.2 * np.sin(8.0 * time_s) * min(time_s, 1.0)
        return moved

    loop.follow(pose, 2.0, 50.0)
    finish(loop)
    metrics = compute_metrics(load_run(tmp_path / "bag"))
    assert 0.5 < metrics.target_too_fast.duration_s < 2.1
    said = [line for line in as_text(metrics).splitlines() if line.startswith("too fast")]
    assert len(said) == 1
    assert re.search(r" s  moves at 1\.[3-6] m/s, faster than target\.max_speed \(1 m/s\)$", said[0])
    plain = json.loads(as_json(metrics))["target_too_fast"]
    assert plain["duration_s"] == pytest.approx(metrics.target_too_fast.duration_s)
    source = RecordingSource(tmp_path / "bag")
    assert replay(source).passed


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_summary_page_is_written(run: Run, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"picture.{suffix}"
    save_summary(run, compute_metrics(run, measured_truth(run)), path)
    assert path.stat().st_size > 20_000


def test_all_lines_of_the_summary_page_are_on_it(run: Run) -> None:
    metrics = compute_metrics(run, measured_truth(run))
    metrics = metrics._replace(
        periods=tuple(StatePeriod("tracking", f"reason {number}", 1.0) for number in range(9)),
        late_steps=metrics.late_steps._replace(hold_ups=1),
        dropped=1,
    )
    with report_style():
        figure = draw_summary(report_run(run, metrics))
        figure.canvas.draw()
        (text,) = [text for axes in figure.axes for text in axes.texts if text.get_family() == ["monospace"]]
        assert "reason 3" in text.get_text()
        assert text.get_window_extent().y0 >= 0.0


def test_summary_page_is_not_blank(run: Run, tmp_path: Path) -> None:
    from matplotlib.image import imread

    path = tmp_path / "picture.png"
    save_summary(run, compute_metrics(run, measured_truth(run)), path)
    pixels = imread(path)
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 200


def test_ground_truth_is_stored_and_read(run: Run, tmp_path: Path) -> None:
    truth = measured_truth(run)
    write_ground_truth(tmp_path / "trajectory.csv", truth)
    again = read_ground_truth(tmp_path / "trajectory.csv")
    assert np.array_equal(again.ros_ns, truth.ros_ns)
    assert np.abs(again.position - truth.position).max() < 1e-11
    with pytest.raises(RecordingError):
        write_ground_truth(tmp_path / "trajectory.csv", truth)
    for text, message in (
        ("a,b\n1,2\n3,4\n", "no position x, y, z"),
        ("x,y,z,qx,qy,qz,qw\n" + "0.1,0.2,0.3,0,0,0,1\n" * 2, "is no ground truth: it holds no time"),
        ("t,x,y\n0,0.1,0.2\n1,0.1,0.2\n", "is no ground truth: it holds no orientation and no z"),
    ):
        (tmp_path / "other.csv").write_text(text)
        with pytest.raises(TrajectoryFileError, match=message):
            read_ground_truth(tmp_path / "other.csv")


def test_command_line(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([str(bag), "--out", str(tmp_path / "p.png")]) == 0
    assert "top speed" in capsys.readouterr().out
    assert (tmp_path / "p.png").exists()
    assert command.main([str(bag), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["robot"] == "panda"
    assert command.main([str(tmp_path)]) == 2
    assert "error:" in capsys.readouterr().err

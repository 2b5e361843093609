"""The verdict names the cause that a run was made with; the split of its error agrees with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from recorded_loop import finish, recorded_loop
from support import PROJECT
from timed_loop import TimedLoop

from ik_node.interfaces.clock import NS
from ik_node.math.types import Array
from ik_node.recording.run_reader import load_run
from ik_node.report import RunMetrics, as_plain, as_text, compute_metrics
from ik_node.report.reported_run import read_reported_runs
from ik_node.report.text import report_plain, what_was_done
from ik_node.report.verdict import Cause, verdict


def of_bag(name: str) -> RunMetrics:
    return read_reported_runs([PROJECT / "bags" / name])[0].metrics


class BackAndForth(TimedLoop):
    """Sideways and back at up to 0.15 m/s, so that late commands become errors."""

    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self._middle, self._zero_ns = self.loop.pose(), self.loop.time_ns

    def pose(self, time_ns: int) -> Array:
        moved: Array = self._middle.copy()
        moved[1, 3] += 0.025 * (1.0 - np.cos(6.0 * (time_ns - self._zero_ns) / NS))
        return moved


def of_loop(path: Path, what: Callable[[TimedLoop], None], kind: type[TimedLoop] = BackAndForth) -> RunMetrics:
    """1.5 s of quiet, ``what``, and 0.5 s of quiet."""
    loop = kind(path)
    loop.run(1500)
    what(loop)
    loop.run(500)
    finish(loop.loop)
    return compute_metrics(load_run(path))


def test_a_good_run_is_tracked_and_never_slowed() -> None:
    metrics = of_bag("inertia_weighted")
    found = verdict(metrics)
    assert found.cause is Cause.TRACKED
    assert metrics.deviation is None
    assert metrics.tracking is not None
    assert found.text.startswith(f"Tracked to {metrics.tracking.settled.position_rms_mm:.2f} mm RMS; never slowed")


@pytest.mark.parametrize(
    ("bag", "cause", "part"),
    [
        ("limit", Cause.SLOWED, "by the position limit of panda_joint7"),
        ("singularity", Cause.SINGULARITY, "a direction was given up at a singularity"),
        ("obstacle", Cause.HELD_OFF, "by the distance panda_hand - post"),
        ("gaps", Cause.TARGETS, "7 of 118 targets were lost"),
        ("ik_difference", Cause.LAG, "the tool lags by"),
    ],
)
def test_the_verdict_of_a_recording_names_its_cause(bag: str, cause: Cause, part: str) -> None:
    metrics = of_bag(bag)
    found = verdict(metrics)
    assert found.cause is cause
    assert part in found.text
    deviation = metrics.deviation
    assert deviation is not None
    assert f"from {deviation.begin_s:.1f} to {deviation.end_s:.1f} s" in found.text
    assert deviation.begin_s <= deviation.peak_s <= deviation.end_s
    # The node's reference followed the lost targets; in all other runs it was the tool that left the reference.
    assert (deviation.reference_part > 0.5) == (cause is Cause.TARGETS)


def test_a_busy_computer_is_named_with_its_rate(tmp_path: Path) -> None:
    """For a second it runs 10 ms of every 60 ms: joint states and targets wait."""

    def busy(loop: TimedLoop) -> None:
        for _ in range(20):
            loop.hold_up(50)
            loop.run(10)

    metrics = of_loop(tmp_path / "bag", busy)
    found = verdict(metrics)
    assert found.cause is Cause.BUSY, found.text
    assert metrics.deviation is not None
    rate = round(metrics.deviation.timing.steps_hz)
    assert rate < 300
    assert f"this computer was busy, {rate} of 500 control steps a second" in found.text


def test_one_hold_up_is_named_with_its_length(tmp_path: Path) -> None:
    found = verdict(of_loop(tmp_path / "bag", lambda loop: loop.hold_up(90)))
    assert found.cause is Cause.BUSY, found.text
    assert "this computer held up the node for 0.09 s" in found.text


def test_a_stop_comes_first_with_its_reason(tmp_path: Path) -> None:
    def silent(loop: TimedLoop) -> None:
        loop.silent = True
        loop.run(400)
        loop.silent = False
        loop.run(600)

    metrics = of_loop(tmp_path / "bag", silent)
    found = verdict(metrics)
    assert found.cause is Cause.STOPPED
    assert found.text.startswith("Stopped for 0.")
    assert "no joint state" in found.text


def test_lost_targets_without_an_effect_are_mentioned(tmp_path: Path) -> None:
    def lose_one(loop: TimedLoop) -> None:
        lost = loop.sent + 1
        loop.is_lost = lambda number: number == lost
        loop.run(500)

    found = verdict(of_loop(tmp_path / "bag", lose_one))
    assert found.cause is Cause.TRACKED
    assert "1 of " in found.text
    assert "targets was lost" in found.text


def test_targets_that_are_too_fast_are_named(tmp_path: Path) -> None:
    """A line at up to 1.6 m/s, faster than the reference may be, by an arm that can follow."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0})
    loop.run(0.1)
    start = loop.pose()

    def pose(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[1, 3] += 0.2 * np.sin(8.0 * time_s) * min(time_s, 1.0)
        return moved

    loop.follow(pose, 3.0, 50.0)
    finish(loop)
    metrics = compute_metrics(load_run(tmp_path / "bag"))
    assert verdict(metrics).cause in (Cause.TOO_FAST, Cause.SLOWED)
    assert metrics.deviation is not None
    assert "faster than target.max_speed" in metrics.deviation.limits.too_fast


def test_a_run_without_targets_has_a_verdict(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0})
    loop.run(0.5)
    finish(loop)
    metrics = compute_metrics(load_run(tmp_path / "bag"))
    found = verdict(metrics)
    assert found.cause is Cause.NO_TARGET
    assert found.text.startswith("No trajectory to compare with; tool to reference ")


def test_a_truncated_recording_is_mentioned() -> None:
    metrics = of_bag("plain")._replace(complete=False)
    assert verdict(metrics).text.endswith("; the recording is truncated.")


def test_the_parts_of_the_error_add_up(tmp_path: Path) -> None:
    """Triangle inequality at every measured joint state; the metrics are the same arrays."""
    for metrics in (of_bag("gaps"), of_bag("limit")):
        series, tracking = metrics.series, metrics.tracking
        assert series is not None
        assert tracking is not None
        parts = series.reference_to_trajectory.position + series.tool_to_reference.position
        known = series.inside & np.isfinite(parts)
        assert known.sum() > 100
        assert (series.tool_to_trajectory.position[known] <= parts[known] + 1e-9).all()
        reference = 1e3 * series.reference_to_trajectory.position[series.settled & np.isfinite(parts)]
        assert tracking.reference_to_trajectory.position_max_mm == pytest.approx(reference.max())


def test_text_and_json_open_with_the_verdict_and_what_was_done(tmp_path: Path) -> None:
    """The recording itself names the simulated arm and the date."""
    metrics = of_loop(tmp_path / "bag", lambda loop: None)
    lines = as_text(metrics).splitlines()
    assert lines[0] == verdict(metrics).text
    assert lines[1] == what_was_done(metrics)
    assert lines[1].startswith("panda, method plain, ")
    assert lines[1].endswith(" UTC, simulated arm")
    plain = report_plain(metrics)
    assert list(plain)[:2] == ["verdict", "cause"]
    assert plain["verdict"] == verdict(metrics).text
    assert plain["simulated"] is True
    assert as_plain(metrics)["tracking"]["reference_to_trajectory"].keys() == plain["tracking"]["settled"].keys()
    assert not any(key.endswith("series") for key in plain)


def test_clearance_to_obstacles_is_apart_from_that_between_links() -> None:
    """The smaller of both is the recorded one, which does not tell them apart."""
    metrics = of_bag("obstacle")
    assert metrics.obstacle_clearance.pair == ("panda_hand", "post")
    assert "post" not in metrics.self_clearance.pair
    assert metrics.obstacle_clearance.least == pytest.approx(metrics.nearness.least, abs=1e-5)
    assert metrics.self_clearance.least > metrics.obstacle_clearance.least


def test_energies_agree_with_the_robot() -> None:
    metrics = of_bag("gravity_gradient")
    run = load_run(PROJECT / "bags" / "gravity_gradient")
    from ik_node.robot.robot import Robot

    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints)
    row = int(np.nanargmax(metrics.energy_series.kinetic))
    q, qd = run.q[row], run.joint_velocity[row]
    assert metrics.energy.kinetic_max_j == pytest.approx(0.5 * qd @ robot.dynamics(q).mass_matrix @ qd)
    # h is the potential whose gradient the method uses.
    step = 1e-6 * np.eye(robot.n)
    slope = [(robot.gravitational_energy(q + e) - robot.gravitational_energy(q - e)) / 2e-6 for e in step]
    assert np.array(slope) == pytest.approx(robot.dynamics(q).gravity, abs=1e-6)
    assert metrics.energy.potential_first_j == pytest.approx(robot.gravitational_energy(run.q[0]))
    assert of_bag("plain").energy.potential == ""

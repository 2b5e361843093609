"""With ``task.tolerance`` the errors of a report are what exceeds it, so that a run that does its task is tracked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_loop import finish, recorded_loop
from support import PROJECT

from ik_node.math import se3
from ik_node.math.task_tolerance import COMPONENTS, TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.recording.run_reader import load_run
from ik_node.report import compute_metrics
from ik_node.report.canvas import report_style
from ik_node.report.overlay import draw_overlay
from ik_node.report.reported_run import ReportedRun, read_reported_runs, report_run
from ik_node.report.run_tasks import RunTask, excess, run_tasks, task_series
from ik_node.report.summary_page import draw_summary
from ik_node.report.table import metric_rows
from ik_node.report.text import what_was_done
from ik_node.report.verdict import Cause, verdict
from ik_node.trajectory.shapes import figure_of_eight

SPIN = (0.0, 0.0, 0.0, 0.0, 0.0, np.inf)


def recorded(folder: Path, tolerance: tuple[float, ...], frame: str = "tool", method: str = "plain") -> Run:
    """A figure of eight whose target also spins about the tool's z axis at 1 rad/s."""
    values = {"rate_hz": 200.0, "obstacles.geometry": "none", "task.tolerance": tolerance, "task.frame": frame}
    loop = recorded_loop(folder / "bag", {**values, "method": method})
    loop.run(0.1)
    figure = figure_of_eight(loop.pose())

    def pose(time_s: float) -> Array:
        found = figure.pose(time_s).copy()
        found[:3, :3] = found[:3, :3] @ se3.exp_rotation(np.array([0.0, 0.0, time_s]))
        return np.asarray(found)

    loop.follow(pose, 4.0, 50.0)
    finish(loop)
    return load_run(folder / "bag")


def test_a_free_spin_is_no_error(tmp_path: Path) -> None:
    run = recorded(tmp_path, SPIN)
    metrics = compute_metrics(run)
    assert metrics.tracking is not None
    assert metrics.series is not None
    assert verdict(metrics).cause is Cause.TRACKED
    tool, target = ([se3.rotation_from_quaternion(row) for row in poses.quaternion]
                    for poses in (metrics.series.measured, metrics.series.desired))  # fmt: skip
    swing = [np.arctan2(np.linalg.norm(np.cross(a[:, 2], b[:, 2])), a[:, 2] @ b[:, 2])
             for a, b in zip(tool, target, strict=True)]  # fmt: skip
    assert metrics.series.tool_to_trajectory.orientation == pytest.approx(np.array(swing), abs=1e-7)
    turned = max(
        np.arccos(np.clip((np.trace(a.T @ b) - 1.0) / 2.0, -1.0, 1.0)) for a, b in zip(tool, target, strict=True)
    )
    assert turned > 1.0, "as whole poses they differ"
    assert "tolerance 0 0 0 0 0 inf in the frame tool" in what_was_done(metrics)


def test_the_same_target_without_a_tolerance_is_an_error_where_a_joint_ends(tmp_path: Path) -> None:
    metrics = compute_metrics(recorded(tmp_path, (0.0,) * 6))
    assert metrics.tracking is not None
    assert metrics.tracking.task == ""
    assert metrics.tracking.settled.orientation_max_mrad > 500.0
    assert verdict(metrics).cause is not Cause.TRACKED
    assert np.isfinite(metrics.tracking.lag_position_ms)


def test_a_deviation_within_a_band_is_no_error_and_beyond_it_the_rest_is() -> None:
    tolerance = TaskTolerance((0.01, 0.0, 0.0, 0.0, 0.0, np.inf))
    target, tool = np.eye(4), np.eye(4)
    for x, expected in ((0.005, 0.0), (-0.01, 0.0), (0.013, 0.003), (-0.04, 0.03)):
        tool[0, 3] = x
        assert excess(tolerance, tool, target) == pytest.approx((expected, 0.0), abs=1e-15)
    tool[:3, 3] = (0.013, 0.004, 0.0)
    assert excess(tolerance, tool, target)[0] == pytest.approx(0.005)


def test_a_change_of_the_task_applies_from_its_time_on(tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0, "obstacles.geometry": "none"})
    loop.run(1.0)
    changed = loop.controller.settings.with_values({"task.tolerance": SPIN})
    loop.controller.apply(changed, loop.now)  # type: ignore[call-arg]
    loop.run(0.5)
    loop.controller.apply(changed.with_values({"gain": (5.0, 5.0)}), loop.now)  # type: ignore[call-arg]
    loop.run(0.5)
    finish(loop)
    tasks = run_tasks(load_run(tmp_path / "bag"))
    assert [task.tolerance.is_exact for task in tasks] == [True, False]
    assert [int(task.rows.sum()) for task in tasks] == [100, 100]


def test_the_table_of_recordings_of_whole_poses_has_no_row_of_the_task() -> None:
    rows = metric_rows(read_reported_runs([PROJECT / "bags" / "plain"]))
    assert "task" not in {row.label for row in rows}


# --- pictures --------------------------------------------------------------------------------------------------------

BAND = (0.0, 0.0, 0.02, 0.0, 0.0, np.inf)


def reported(run: Run) -> ReportedRun:
    return report_run(run, compute_metrics(run))


def drawn_components(drawn: Any) -> dict[str, Any]:
    """Name of the component -> axes."""
    named = {tuple(label.get_text() for label in axes.get_yticklabels()): axes for axes in drawn.axes}
    return {names[0]: axes for names, axes in named.items() if len(names) == 1 and names[0] in COMPONENTS}


def test_the_pictures_show_free_parts_and_bands_apart_from_the_errors(tmp_path: Path) -> None:
    run = recorded(tmp_path, BAND)
    one = reported(run)
    series = one.metrics.series
    assert series is not None
    with report_style():
        pages = draw_summary(one), draw_overlay([one, one])
    for page in pages:
        found = drawn_components(page)
        assert sorted(found) == ["rz", "z"]
        (strip, *_), (line, *_) = found["z"].collections, found["z"].lines
        assert np.abs(strip.get_paths()[0].vertices[:, 1]).max() == pytest.approx(20.0)
        inside = series.inside
        offset = [
            se3.rotation_from_quaternion(q).T @ (d - b)
            for q, d, b in zip(
                series.measured.quaternion[inside],
                series.desired.position[inside],
                series.measured.position[inside],
                strict=True,
            )
        ]
        values = line.get_ydata()[np.isfinite(line.get_ydata())]
        assert values == pytest.approx(1e3 * np.array(offset)[:, 2], abs=1e-2)
        assert not found["rz"].collections
        spun = np.abs(found["rz"].lines[0].get_ydata())
        assert np.nanmax(spun) > 1000.0, "the target spins at 1 rad/s"
        assert found["rz"].get_ylim()[1] > np.nanmax(spun)
    texts = [text.get_text() for axes in drawn_components(_summary(one)).values() for text in axes.texts]
    assert [text.split(":")[0] for text in texts if text.startswith("free")] == ["free"]
    assert any(text.endswith("of \N{PLUS-MINUS SIGN}20 mm") for text in texts)


def _summary(one: ReportedRun) -> Any:
    with report_style():
        return draw_summary(one)


def test_a_free_rotation_that_passes_half_a_turn_is_drawn_with_a_gap() -> None:
    angles = np.linspace(0.0, 7.0, 50)
    tool = np.tile(np.eye(4), (50, 1, 1))
    target = tool.copy()
    for pose, angle in zip(target, angles.tolist(), strict=True):
        pose[:3, :3] = se3.exp_rotation(np.array([0.0, 0.0, angle]))
    series = task_series([RunTask(TaskTolerance(SPIN), np.ones(50, dtype=bool))], tool, target)
    assert series is not None
    assert series.components[:, 5] == pytest.approx((angles + np.pi) % (2.0 * np.pi) - np.pi, abs=1e-12)
    assert np.isinf(series.half_widths[:, 5]).all()


def test_a_target_of_whole_poses_has_no_plot_of_components() -> None:
    one = read_reported_runs([PROJECT / "bags" / "plain"])[0]
    assert one.metrics.series is not None
    assert one.metrics.series.task is None
    assert drawn_components(_summary(one)) == {}


def test_components_are_known_only_while_a_tolerance_applies() -> None:
    tool, rows = np.tile(np.eye(4), (4, 1, 1)), np.array([True, True, False, False])
    target = tool.copy()
    target[:, 0, 3] = 0.01
    target[3] = np.nan
    series = task_series([RunTask(TaskTolerance(), rows), RunTask(TaskTolerance(BAND), ~rows)], tool, target)
    assert series is not None
    assert np.isnan(series.components[:2]).all()
    assert series.components[2, 0] == pytest.approx(0.01)
    assert np.isnan(series.components[3]).all()
    assert np.isnan(series.half_widths[:2]).all()

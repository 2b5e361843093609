"""Reports of one recording and of several: all pages exist, are well-formed, and need no network.

The appearance of the plots was inspected by eye; these tests check the content of the files.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from recorded_loop import RecordedCaller, finish, recorded_loop
from support import PROJECT

from ik_node.cli import report as command
from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.step import Mode
from ik_node.report.atomic_write import WRITERS, check_suffix, write_report
from ik_node.report.canvas import report_style
from ik_node.report.html import as_html
from ik_node.report.reported_run import ReportedRun, names_of, read_reported_runs
from ik_node.report.solver_page import draw_solver
from ik_node.report.states_page import draw_states
from ik_node.report.summary_page import draw_summary
from ik_node.report.table import as_table, metric_rows
from ik_node.report.timeline import condition_spans, state_intervals
from ik_node.report.verdict import verdict

BAGS = [PROJECT / "bags" / name for name in ("plain", "limit", "singularity")]


@pytest.fixture(scope="module")
def several() -> tuple[ReportedRun, ...]:
    return read_reported_runs(BAGS)


@pytest.fixture(scope="module")
def page_of_several(several: tuple[ReportedRun, ...]) -> str:
    return as_html(several)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> ReportedRun:
    """A run that is paused with a reason that contains markup."""
    directory = tmp_path_factory.mktemp("run") / "bag"
    loop = recorded_loop(directory, {"rate_hz": 100.0, "method": "gravity_gradient"})
    loop.run(0.1)
    goal = loop.pose()
    goal[:3, 3] += 0.05
    for _ in range(10):
        loop.target(goal)
        loop.run(0.05)
    controller: RecordedCaller = loop.controller  # type: ignore[assignment]
    controller.pause(loop.now, "paused by <b>me</b> & you")
    loop.run(0.5)
    finish(loop)
    return read_reported_runs([directory])[0]


def test_html_is_one_complete_file(
    several: tuple[ReportedRun, ...], page_of_several: str, stopped: ReportedRun
) -> None:
    """Well-formed, with every section and page; no script, no external resource; recorded texts are escaped."""
    for reported_runs, text in ((several, page_of_several), ((stopped,), as_html((stopped,)))):
        page = ET.fromstring(text.split("\n", 1)[1])
        assert [section.get("id") for section in page.iter("section")] == [
            "plots",
            "metrics",
            "timeline",
            "parameters",
            "versions",
        ]
        images = [image.get("src", "") for image in page.iter("img")]
        assert len(images) == 4
        assert all(source.startswith("data:image/svg+xml;base64,") for source in images)
        assert not list(page.iter("script"))
        assert not list(page.iter("link"))
        assert not re.search(r'(src|href)="https?:', text)
        for reported in reported_runs:
            assert reported.name in text
    assert "paused by &lt;b&gt;me&lt;/b&gt; &amp; you" in text
    assert "gravity_gradient" in text, "a parameter that differs from its default"
    verdicts = [node.text for node in page.iter("p") if node.get("class") == "verdict"]
    assert verdicts == [verdict(stopped.metrics).text]
    (numbers,) = [section for section in page.iter("section") if section.get("id") == "metrics"]
    assert all("".join(row[-1].itertext()) for row in numbers.iter("tr")), "every number has its meaning"


def test_what_is_zero_throughout_is_a_line_of_text_on_the_page_of_the_solver(
    several: tuple[ReportedRun, ...], stopped: ReportedRun
) -> None:
    """No plot is empty, the rows of the others are aligned, and no title is below its legend."""
    for reported_runs in ((several[0],), (several[1],), (stopped,), several):
        with report_style():
            figure = draw_solver(reported_runs)
            figure.draw_without_rendering()
        assert all(axes.lines for axes in figure.axes)
        titles = [axes.get_title(loc="left") for axes in figure.axes]
        notes = [text.get_text() for text in figure.texts if text.get_text() != "Solver"]
        assert len(titles) + len(notes) == 12
        assert not any(note.startswith(tuple(titles)) for note in notes)
        lefts = [axes.get_position().x0 for axes in figure.axes]
        assert len({round(axes.get_position().y0, 6) for axes in figure.axes}) == max(map(lefts.count, lefts))
        for axes, title in zip(figure.axes, titles, strict=True):
            if axes.get_legend() is not None:
                (drawn,) = axes.findobj(lambda artist, title=title: getattr(artist, "get_text", str)() == title)
                assert drawn.get_window_extent().x1 < axes.get_legend().get_window_extent().x0, title
    with report_style():
        notes = [text.get_text() for text in draw_solver((several[0],)).texts]
    assert "Twist not done, linear [mm/s]: none" in notes


def test_timeline_has_every_state_with_its_reason(stopped: ReportedRun) -> None:
    """In order, without gaps: holding, tracking, ramping, paused."""
    found = state_intervals(stopped)
    modes = [entry.mode for entry in found]
    assert modes.index(Mode.TRACKING) < modes.index(Mode.PAUSED)
    assert "paused by <b>me</b> & you" in [entry.reason for entry in found if entry.mode is Mode.PAUSED]
    assert [entry.number for entry in found] == list(range(1, len(found) + 1))
    for first, second in itertools.pairwise(found):
        assert first.begin_s + first.duration_s == pytest.approx(second.begin_s)


def test_slowed_and_given_up_times_are_marked(several: tuple[ReportedRun, ...], page_of_several: str) -> None:
    plain, limit, singularity = map(condition_spans, several)
    assert (plain.slowed, plain.given_up) == ([], [])
    slowed = sum(duration for _, duration in limit.slowed)
    assert slowed == pytest.approx(several[1].metrics.scaling.slowed_s, abs=0.02)
    given_up = sum(duration for _, duration in singularity.given_up)
    assert given_up == pytest.approx(several[2].metrics.singularity.truncated_s, abs=0.02)
    assert "direction given up" in page_of_several
    assert 'class="conditions"' in page_of_several


def timing_plots(reported_runs: Sequence[ReportedRun]) -> dict[str, Any]:
    """Title -> axes of the plots of times on the last page."""
    with report_style():
        found = {axes.get_title(loc="left"): axes for axes in draw_states(reported_runs).axes}
    return {title: axes for title, axes in found.items() if "[ms" in title}


def test_plots_without_data_are_left_out(stopped: ReportedRun, several: tuple[ReportedRun, ...]) -> None:
    """One run without computing times, targets beyond the first second, or hold-ups, and one with computing times."""
    assert np.isnan(stopped.run.computing_s).all()
    for computed in (False, True):
        times = np.full_like(stopped.run.computing_s, 1e-3 if computed else np.nan)
        reported = stopped._replace(run=stopped.run._replace(computing_s=times))
        plots = timing_plots([reported])
        assert plots and all(axes.has_data() for axes in plots.values())
        assert ("Computing time [ms] over time" in plots) == computed
    assert all(axes.has_data() for axes in timing_plots(several).values())


def test_recorded_obstacles_are_drawn_wherever_the_recording_is_read() -> None:
    """The scene file of the run need not be there."""
    (reported,) = read_reported_runs([PROJECT / "bags" / "obstacle"])
    assert [obstacle.name for obstacle in reported.obstacles] == ["post"]
    settings = {**reported.run.settings, "obstacles.scene": "/nowhere/scene.yaml"}
    elsewhere = reported._replace(run=reported.run._replace(settings=settings))
    with report_style():
        shown, hidden = (draw_summary(each).axes for each in (elsewhere, elsewhere._replace(obstacles=())))
    path, without = (next(axes for axes in each if axes.name == "3d") for each in (shown, hidden))
    assert len(path.get_children()) > len(without.get_children())


def test_table_compares_several_recordings(several: tuple[ReportedRun, ...]) -> None:
    """Each column equals the table of that recording alone; times are relative to the first target."""
    table = as_table(several)
    assert table.splitlines()[0].split() == ["plain", "limit", "singularity"]
    by_label = {row.label: row.values for row in metric_rows(several)}
    assert len(by_label) > 30
    for index, reported in enumerate(several):
        alone = {row.label: row.values[0] for row in metric_rows([reported])}
        assert {label: values[index] for label, values in by_label.items() if label in alone} == alone
        assert reported.times_s[0] < 0.0 < reported.times_s[-1]
    least = "smallest singular value, min [m]"
    assert float(by_label[least][2]) < 0.01 < float(by_label[least][0])


@pytest.mark.parametrize("ending", sorted(WRITERS))
def test_every_format_is_written_for_one_and_for_several(
    several: tuple[ReportedRun, ...], stopped: ReportedRun, tmp_path: Path, ending: str
) -> None:
    for name, reported_runs in (("one", (stopped,)), ("several", several[:2])):
        path = tmp_path / f"{name}{ending}"
        write_report(reported_runs, path)
        data = path.read_bytes()
        assert len(data) > 20_000
        if ending == ".pdf":
            assert len(re.findall(rb"/Type /Page\b", data)) == 4
    with pytest.raises(RecordingError, match="cannot be written"):
        write_report((stopped,), tmp_path / "nowhere" / path.name)


def test_failed_writing_keeps_the_existing_file(
    stopped: ReportedRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.svg"
    path.write_text("previous")

    def fail(reported_runs: Sequence[ReportedRun], target: Path) -> None:
        target.write_text("half")
        raise RecordingError("no space left")

    monkeypatch.setitem(WRITERS, ".svg", fail)
    with pytest.raises(RecordingError, match="no space"):
        write_report((stopped,), path)
    assert path.read_text() == "previous"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.svg"]


def test_same_recordings_give_the_same_bytes(several: tuple[ReportedRun, ...], tmp_path: Path) -> None:
    for name in ("one.pdf", "other.pdf"):
        write_report(several[:1], tmp_path / name)
    assert (tmp_path / "one.pdf").read_bytes() == (tmp_path / "other.pdf").read_bytes()


def test_names_of_recordings_are_distinct() -> None:
    assert names_of([Path("/a/monday/bag"), Path("/a/tuesday/bag")]) == ("monday", "tuesday")
    assert names_of([Path("/a/x/run"), Path("/b/x/run")]) == ("a/x/run", "b/x/run")
    assert names_of([Path("/a/run"), Path("/a/run")]) == ("run", "run (2)")


def test_command_line_writes_the_requested_formats(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files are named after the recordings; the JSON is a list of finite metrics; errors give exit code 2."""
    monkeypatch.chdir(tmp_path)
    assert command.main([str(bag) for bag in BAGS[:2]] + ["--html", "--json"]) == 0
    written = capsys.readouterr()
    assert Path("report_plain_limit.html").is_file()
    assert "report_plain_limit.html" in written.err
    metrics = json.loads(written.out)
    assert [entry["name"] for entry in metrics] == ["plain", "limit"]
    assert np.isfinite([entry["tracking"]["settled"]["position_rms_mm"] for entry in metrics]).all()
    assert command.main([str(BAGS[0]), str(tmp_path / "absent")]) == 2
    assert "absent" in capsys.readouterr().err
    assert command.main([str(BAGS[0]), "--out", "report.doc"]) == 2
    assert ".png" in capsys.readouterr().err
    with pytest.raises(InputError, match="valid"):
        check_suffix(Path("report.doc"))

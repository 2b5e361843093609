"""Reports of one recording and of several: every page is there, readable by machines, and needs no network.

The pictures themselves were looked at; here their files are checked: what they hold, and that nothing is left out.
"""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from recorded_loop import RecordedController, finish, recorded_loop
from support import PROJECT

from ik_node.cli import report as command
from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.step import Mode
from ik_node.report.atomic_write import WRITERS, writer_for
from ik_node.report.html import as_html
from ik_node.report.reported_run import Subject, names_of, read_subjects
from ik_node.report.table import as_table, rows
from ik_node.report.timeline import entries

BAGS = [PROJECT / "bags" / name for name in ("plain", "limit", "singularity")]


@pytest.fixture(scope="module")
def several() -> tuple[Subject, ...]:
    return read_subjects(BAGS)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Subject:
    """A run that is paused on its way, by somebody whose reason is no markup."""
    directory = tmp_path_factory.mktemp("run") / "bag"
    loop = recorded_loop(directory, {"rate_hz": 100.0, "method": "gravity_gradient"})
    loop.run(0.1)
    goal = loop.pose()
    goal[:3, 3] += 0.05
    for _ in range(10):
        loop.target(goal)
        loop.run(0.05)
    controller: RecordedController = loop.controller  # type: ignore[assignment]
    controller.pause(loop.now, "paused by <b>me</b> & you")
    loop.run(0.5)
    finish(loop)
    return read_subjects([directory])[0]


def test_the_html_is_one_whole_file(several: tuple[Subject, ...], stopped: Subject) -> None:
    """Well-formed, every section, a picture per page; no script, nothing from elsewhere; recorded words are escaped."""
    for subjects in (several, (stopped,)):
        text = as_html(subjects)
        page = ET.fromstring(text.split("\n", 1)[1])
        assert [section.get("id") for section in page.iter("section")] == [
            "figures",
            "pictures",
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
        for subject in subjects:
            assert subject.name in text
    assert "paused by &lt;b&gt;me&lt;/b&gt; &amp; you" in text
    assert "gravity_gradient" in text, "a parameter that differs from its default"


def test_the_timeline_has_every_state_with_its_reason(stopped: Subject) -> None:
    """In order, without gaps: from holding to tracking, the ramp, the pause."""
    found = entries(stopped)
    modes = [entry.mode for entry in found]
    assert modes.index(Mode.TRACKING) < modes.index(Mode.PAUSED)
    assert "paused by <b>me</b> & you" in [entry.reason for entry in found if entry.mode is Mode.PAUSED]
    assert [entry.number for entry in found] == list(range(1, len(found) + 1))
    for one, other in itertools.pairwise(found):
        assert one.begin_s + one.duration_s == pytest.approx(other.begin_s)


def test_several_stand_beside_each_other(several: tuple[Subject, ...]) -> None:
    """A column of figures each, the same as of each alone; times count from the first target of each."""
    table = as_table(several)
    assert table.splitlines()[0].split() == ["plain", "limit", "singularity"]
    by_label = {row.label: row.values for row in rows(several)}
    assert len(by_label) > 30
    for index, subject in enumerate(several):
        alone = {row.label: row.values[0] for row in rows([subject])}
        assert {label: values[index] for label, values in by_label.items() if label in alone} == alone
        assert subject.times_s[0] < 0.0 < subject.times_s[-1]
    assert float(by_label["least singular value [m]"][2]) < 0.01 < float(by_label["least singular value [m]"][0])


@pytest.mark.parametrize("ending", sorted(WRITERS))
def test_every_kind_is_written_for_one_and_for_several(
    several: tuple[Subject, ...], stopped: Subject, tmp_path: Path, ending: str
) -> None:
    for name, subjects in (("one", (stopped,)), ("several", several)):
        path = tmp_path / f"{name}{ending}"
        writer_for(path)(subjects, path)
        data = path.read_bytes()
        assert len(data) > 20_000
        if ending == ".pdf":
            assert len(re.findall(rb"/Type /Page\b", data)) == 4
    with pytest.raises(RecordingError, match="cannot be written"):
        writer_for(path)((stopped,), tmp_path / "nowhere" / path.name)


def test_the_same_recordings_give_the_same_bytes(several: tuple[Subject, ...], tmp_path: Path) -> None:
    for name in ("one.pdf", "other.pdf"):
        writer_for(tmp_path / name)(several[:1], tmp_path / name)
    assert (tmp_path / "one.pdf").read_bytes() == (tmp_path / "other.pdf").read_bytes()


def test_names_tell_recordings_apart() -> None:
    assert names_of([Path("/a/monday/bag"), Path("/a/tuesday/bag")]) == ("monday", "tuesday")
    assert names_of([Path("/a/x/run"), Path("/b/x/run")]) == ("a/x/run", "b/x/run")
    assert names_of([Path("/a/run"), Path("/a/run")]) == ("run", "run (2)")


def test_the_command_writes_what_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files are named after the recordings; machines get a list of finite figures; what cannot be, ends with code 2."""
    monkeypatch.chdir(tmp_path)
    assert command.main([str(bag) for bag in BAGS[:2]] + ["--html", "--json"]) == 0
    written = capsys.readouterr()
    assert Path("report_plain_limit.html").is_file()
    assert "report_plain_limit.html" in written.err
    figures = json.loads(written.out)
    assert [entry["name"] for entry in figures] == ["plain", "limit"]
    assert np.isfinite([entry["tracking"]["settled"]["position_rms_mm"] for entry in figures]).all()
    assert command.main([str(BAGS[0]), str(tmp_path / "absent")]) == 2
    assert "absent" in capsys.readouterr().err
    assert command.main([str(BAGS[0]), "--out", "report.doc"]) == 2
    assert ".png" in capsys.readouterr().err
    with pytest.raises(InputError, match="valid"):
        writer_for(Path("report.doc"))

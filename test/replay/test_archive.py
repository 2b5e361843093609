"""Many recordings: rows, tables and page; what is done is kept; a broken recording and a dead process cost one row."""

from __future__ import annotations

import csv
import gc
import io
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest
from browser import Browser
from support import PROJECT, skip_unless_others_can_read
from waiting import ENOUGH_S, wait_until

from ik_node.cli import replay as command
from ik_node.errors import MissingPackageError, RecordingError
from ik_node.recording.mcap.reader import part_files
from ik_node.replay.archive import table
from ik_node.replay.archive.bags import FoundBag, find_bags, is_archive
from ik_node.replay.archive.local_pool import replay_locally
from ik_node.replay.archive.page import as_page
from ik_node.replay.archive.row import BROKEN, SAME, BagResult, BagRow, ReplayTask, replay_bag
from ik_node.replay.archive.run import ArchiveResult, replay_archive

QUICK = ReplayTask(report=False)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two recordings in folders of different depth, and one whose file is damaged."""
    folder = tmp_path_factory.mktemp("fleet")
    shutil.copytree(PROJECT / "bags" / "limit", folder / "monday" / "arm 1" / "limit")
    shutil.copytree(PROJECT / "bags" / "plain", folder / "tuesday" / "plain")
    (folder / "broken").mkdir()
    whole = (PROJECT / "bags" / "plain" / "plain_0.mcap").read_bytes()
    (folder / "broken" / "broken_0.mcap").write_bytes(whole[:200] + bytes(500))
    (folder / "notes.txt").write_text("no recording")
    return folder


def here(bags: Sequence[FoundBag], task: ReplayTask) -> Iterator[tuple[FoundBag, BagResult]]:
    """Replays in this process."""
    for bag in bags:
        yield bag, replay_bag(bag, task)


def never(bags: Sequence[FoundBag], task: ReplayTask) -> Iterator[tuple[FoundBag, BagResult]]:
    raise AssertionError(f"{[bag.name for bag in bags]} are done already")


@pytest.fixture(scope="module")
def result(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[ArchiveResult, Path, str]:
    folder, output = tmp_path_factory.mktemp("table"), io.StringIO()
    return replay_archive(find_bags([str(fleet)]), ReplayTask(), here, folder, output), folder, output.getvalue()


def rows_by_name(found: ArchiveResult) -> dict[str, BagRow]:
    return {Path(row.bag).name: row for row in found.rows}


def test_recordings_are_found_at_any_depth_and_once(fleet: Path) -> None:
    names = [Path(bag.name).name for bag in find_bags([str(fleet), str(fleet / "tuesday")])]
    assert names == ["broken", "limit", "plain"]
    assert is_archive([str(fleet)])
    assert is_archive([str(fleet / "broken"), str(fleet / "tuesday")])
    assert not is_archive([str(fleet / "tuesday" / "plain")])
    assert not is_archive([str(fleet / "nothing")])
    with pytest.raises(RecordingError, match="contains no recording"):
        find_bags([str(PROJECT / "docs")])
    with pytest.raises(RecordingError, match="does not exist"):
        find_bags([str(fleet), str(fleet / "nothing")])


def test_linked_folders_are_followed_and_loops_end(fleet: Path, tmp_path: Path) -> None:
    """Days of an archive may be on several disks; a disk that is not there is named."""
    (tmp_path / "disk").mkdir()
    shutil.copytree(fleet / "broken", tmp_path / "disk" / "here")
    (tmp_path / "disk" / "monday").symlink_to(fleet / "monday")
    (tmp_path / "disk" / "tuesday run").symlink_to(fleet / "tuesday" / "plain")
    (tmp_path / "disk" / "twice").symlink_to(fleet / "tuesday")
    (tmp_path / "disk" / "loop").symlink_to(tmp_path)
    (tmp_path / "disk" / "nowhere").symlink_to(tmp_path / "nothing")
    names = [str(Path(bag.name).relative_to(tmp_path)) for bag in find_bags([str(tmp_path)])]
    assert names == ["disk/nowhere", "disk/here", "disk/monday/arm 1/limit", "disk/tuesday run"]


def test_every_recording_is_a_row_and_a_broken_one_does_not_end_the_others(
    result: tuple[ArchiveResult, Path, str],
) -> None:
    rows = rows_by_name(result[0])
    assert rows["plain"].replay == rows["limit"].replay == SAME
    tracked = f"Tracked to {rows['plain'].position_rms_mm:.2f} mm RMS; never slowed"
    assert rows["plain"].verdict.startswith(tracked)
    assert rows["limit"].worst_limit == "position panda_joint7"
    assert rows["limit"].slowed_s == pytest.approx(0.78, abs=0.03)
    assert rows["broken"].replay == BROKEN
    assert rows["broken"].error.startswith("holds no run of ik_node"), "without the folder, which is in the row"
    progress = result[2].splitlines()
    assert progress[0] == "0 of 3 recordings"
    assert progress[-1].startswith("3 of 3 recordings, 1 with an error")


def test_the_same_table_is_written_as_text_csv_json_and_page(result: tuple[ArchiveResult, Path, str]) -> None:
    found, folder, _ = result
    lines = list(csv.DictReader(io.StringIO((folder / "table.csv").read_text())))
    assert [line["bag"] for line in lines] == [row.bag for row in found.rows]
    assert float(lines[1]["position_rms_mm"]) == found.rows[1].position_rms_mm
    assert lines[0]["position_rms_mm"] == ""
    assert json.loads((folder / "table.json").read_text()) == [row._asdict() for row in found.rows]
    text = table.as_text(found.rows).splitlines()
    assert len(text) == 5
    assert text[-1] == "3 recordings: 2 same bits, 1 not replayable"
    assert "same bits" in text[2]
    page = (folder / "index.html").read_text()
    for row in found.rows:
        assert row.bag in page
    links = page.split('href="')[1:]
    assert len(links) == 2, "the broken one has no report"
    for link in links:
        assert (
            "<svg" in (folder / link.split('"')[0]).read_text()
            or (folder / link.split('"')[0]).stat().st_size > 100_000
        )


def test_what_is_done_is_not_done_again_until_the_recording_or_the_task_changes(
    fleet: Path, result: tuple[ArchiveResult, Path, str]
) -> None:
    found, folder, _ = result
    bags = find_bags([str(fleet)])
    again = replay_archive(bags, ReplayTask(), never, folder, io.StringIO())
    assert again.rows == found.rows
    assert again.kept == 3
    with pytest.raises(AssertionError, match="are done already"):
        replay_archive(bags, ReplayTask(methods=("plain",)), never, folder, io.StringIO())
    changed = [bag._replace(fingerprint="other") if bag.name.endswith("plain") else bag for bag in bags]
    with pytest.raises(AssertionError, match=r"^\['[^']*plain'\] are done already"):
        replay_archive(changed, ReplayTask(), never, folder, io.StringIO())


def test_a_call_that_was_ended_continues(fleet: Path, tmp_path: Path) -> None:
    """The row that was being written when it ended is computed again."""

    def ended(bags: Sequence[FoundBag], task: ReplayTask) -> Iterator[tuple[FoundBag, BagResult]]:
        yield bags[0], BagResult(BagRow(bags[0].name, robot="first"), "")
        raise KeyboardInterrupt

    bags = [FoundBag("a", "1"), FoundBag("b", "1")]
    with pytest.raises(KeyboardInterrupt):
        replay_archive(bags, QUICK, ended, tmp_path, io.StringIO())
    (kept,) = (tmp_path / "rows").glob("*.json")
    page = (tmp_path / "index.html").read_text()
    assert "<h1>1 of 2 recordings</h1>" in page
    assert "<td>first</td>" in page
    assert [row["bag"] for row in json.loads((tmp_path / "table.json").read_text())] == ["a"]
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 2
    asked: list[str] = []

    def rest(bags: Sequence[FoundBag], task: ReplayTask) -> Iterator[tuple[FoundBag, BagResult]]:
        asked.extend(bag.name for bag in bags)
        return ((bag, BagResult(BagRow(bag.name, robot="second"), "")) for bag in bags)

    found = replay_archive(bags, QUICK, rest, tmp_path, io.StringIO())
    assert asked == ["b"]
    assert [row.robot for row in found.rows] == ["first", "second"]
    assert "<h1>2 recordings</h1>" in (tmp_path / "index.html").read_text()
    kept.write_text(kept.read_text()[:20])
    replay_archive(bags, QUICK, rest, tmp_path, io.StringIO())
    assert asked == ["b", "a"]


def test_a_killed_call_leaves_the_tables_of_what_it_had_done(tmp_path: Path) -> None:
    """They are written at times, not only at the end."""
    bags = [FoundBag(name, "1") for name in "abcd"]
    times_s = {"a": 0.5, "b": 12.0, "c": 12.5, "d": 60.0}
    now_s = 0.0
    tables: list[list[str]] = []

    def slow(bags: Sequence[FoundBag], task: ReplayTask) -> Iterator[tuple[FoundBag, BagResult]]:
        nonlocal now_s
        for bag in bags:
            now_s = times_s[bag.name]
            yield bag, BagResult(BagRow(bag.name), "")
            file = tmp_path / "table.json"
            tables.append([row["bag"] for row in json.loads(file.read_text())] if file.is_file() else [])

    replay_archive(bags, QUICK, slow, tmp_path, io.StringIO(), lambda: now_s)
    assert tables == [[], ["a", "b"], ["a", "b"], ["a", "b", "c", "d"]]


@pytest.fixture
def not_root() -> Iterator[Path]:
    """A folder; its files are accessed with the rights of a user that is not root."""
    skip_unless_others_can_read()
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        user = os.geteuid()
        if user == 0:
            os.seteuid(65534)
        try:
            yield Path(folder)
        finally:
            os.seteuid(user)


def test_what_cannot_be_read_is_a_row_with_the_reason(fleet: Path, not_root: Path) -> None:
    user, me = os.geteuid(), os.getuid()
    os.seteuid(me)  # the owner prepares the folders, and loads the stored machine code, which only he may read
    (known,) = find_bags([str(fleet / "tuesday")])
    assert replay_bag(known, QUICK).row.replay == SAME
    names = ("not listed", "not entered", "no file", "good")
    for name in names:
        shutil.copytree(fleet / "tuesday" / "plain", not_root / name)
    (not_root / "gone").symlink_to(not_root / "nowhere")
    (not_root / "not listed").chmod(0o300)
    (not_root / "not entered").chmod(0o644)
    (file,) = (not_root / "no file").glob("*.mcap")
    file.chmod(0)
    os.seteuid(user)
    found = {Path(bag.name).name: bag for bag in find_bags([str(not_root)])}
    assert sorted(found) == sorted((*names, "gone"))
    rows = {name: replay_bag(bag, QUICK).row for name, bag in found.items()}
    assert rows["good"].replay == SAME
    for name in ("not listed", "not entered"):
        assert rows[name].error == "the folder cannot be read: Permission denied"
    assert rows["gone"].error == f"a link to '{not_root / 'nowhere'}', which does not exist"
    assert "Permission denied" in rows["no file"].error
    assert {rows[name].replay for name in ("not listed", "not entered", "no file", "gone")} == {BROKEN}
    os.seteuid(me)
    for path, mode in ((not_root / "not listed", 0o755), (not_root / "not entered", 0o755), (file, 0o644)):
        path.chmod(mode)
    os.seteuid(user)
    again = {Path(bag.name).name: bag for bag in find_bags([str(not_root)])}
    assert [name for name in found if again[name] == found[name]] == ["gone", "good"], "what was mended is read again"


def test_one_folder_that_cannot_be_read_is_an_error(not_root: Path) -> None:
    closed = not_root / "closed"
    user = os.geteuid()
    os.seteuid(os.getuid())
    closed.mkdir()
    closed.chmod(0o300)
    os.seteuid(user)
    assert not is_archive([str(closed)])
    with pytest.raises(RecordingError, match=r"closed' cannot be read: Permission denied$"):
        part_files(closed)


def test_what_if_runs_stand_beside_the_recording(fleet: Path) -> None:
    (bag,) = find_bags([str(fleet / "tuesday")])
    task = ReplayTask(("gravity_gradient",), {}, report=False)
    row = replay_bag(bag, task).row
    assert list(row.what_if) == ["recorded", "gravity_gradient"]
    assert row.what_if["recorded"]["position_rms_mm"] == pytest.approx(row.position_rms_mm, rel=0.2)
    assert "position_rms_mm [gravity_gradient]" in table.columns_of([row])
    assert "what if gravity_gradient: " in table.as_text([row])


def test_results_are_not_kept_after_they_were_used(fleet: Path) -> None:
    """A report has some MB, an archive thousands of them."""
    used: set[str] = set()
    # By type: isinstance() asks proxies of other tests for the class of an object that is gone.
    of_other_tests = [thing for thing in gc.get_objects() if type(thing) is BagResult]
    for bag, _ in replay_locally(find_bags([str(fleet)]), QUICK, jobs=1):
        kept = {
            thing.row.bag
            for thing in gc.get_objects()
            if type(thing) is BagResult and not any(thing is other for other in of_other_tests)
        }
        assert bag.name in kept
        assert not kept & used
        used.add(bag.name)
    assert len(used) == 3


def test_a_killed_process_does_not_lose_its_recordings(fleet: Path) -> None:
    """All processes of the pool are killed after the first result; the rest is replayed one by one."""
    of_other_tests = set(multiprocessing.active_children())  # as those of the benchmarks, which are used again
    bags = find_bags([str(fleet)])
    found: dict[str, str] = {}
    for bag, result in replay_locally(bags, QUICK, jobs=1):
        if not found:
            for process in set(multiprocessing.active_children()) - of_other_tests:
                process.kill()
        found[Path(bag.name).name] = result.row.replay
    assert found == {"broken": BROKEN, "limit": SAME, "plain": SAME}


RECORDINGS = 300
"""So many that a test that is held up for seconds still interrupts them."""


@contextmanager
def started(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """The command on many recordings, in a session of its own, after its first row."""
    for number in range(RECORDINGS):
        (folder / "fleet" / f"run {number}").mkdir(parents=True)
        shutil.copy(
            PROJECT / "bags" / "limit" / "limit_0.mcap", folder / "fleet" / f"run {number}" / f"{number}_0.mcap"
        )
    command = [sys.executable, "-m", "ik_node.cli.replay", str(folder / "fleet"), "--jobs", "2", "--no-reports"]
    rows = folder / "ik_replay_table" / "rows"
    process = subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        wait_until(lambda: any(rows.glob("*.json")) or process.poll() is not None)
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.mark.parametrize("to_all", [True, False], ids=["of a terminal", "to the command alone"])
def test_ctrl_c_ends_it_soon_and_without_a_traceback(to_all: bool, tmp_path: Path) -> None:
    """Only what is being replayed is waited for, not the rest of the archive."""
    with started(tmp_path) as process:
        (os.killpg if to_all else os.kill)(process.pid, signal.SIGINT)
        _, printed = process.communicate(timeout=ENOUGH_S)
    assert process.returncode == 130, printed
    assert "Traceback" not in printed
    done = len(list((tmp_path / "ik_replay_table" / "rows").glob("*.json")))
    assert 1 <= done < RECORDINGS // 2
    assert f"<h1>{done} of {RECORDINGS} recordings</h1>" in (tmp_path / "ik_replay_table" / "index.html").read_text()
    assert "the same command continues" in printed.splitlines()[-1]


def test_its_processes_end_with_it(tmp_path: Path) -> None:
    """Also when it is killed: a process that replays takes 1 GB."""
    with started(tmp_path) as process:
        process.kill()
        process.communicate(timeout=ENOUGH_S)

        def is_gone() -> bool:
            try:
                os.killpg(process.pid, 0)
            except ProcessLookupError:
                return True
            return False

        try:
            wait_until(is_gone)
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)
            raise


def test_command_line(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["--out", str(tmp_path / "table"), "--no-reports", "--jobs", "1"]
    assert command.main([str(fleet / "tuesday"), *out]) == 0
    written = capsys.readouterr()
    assert written.out.splitlines()[-1] == "1 recording: 1 same bits"
    assert "table.csv" in written.err
    assert command.main([str(fleet / "broken"), str(fleet / "tuesday"), *out, "--json"]) == 2
    written = capsys.readouterr()
    assert [row["replay"] for row in json.loads(written.out)] == [BROKEN, SAME]
    assert "2 of 2 recordings, 1 of them done before" in written.err
    assert command.main([str(fleet), "--ros"]) == 2
    assert "--ros: no effect for many recordings" in capsys.readouterr().err
    assert command.main([str(fleet / "tuesday" / "plain"), "--dask", "tcp://127.0.0.1:1"]) == 2
    assert "--dask: no effect for one recording" in capsys.readouterr().err


def test_a_missing_package_is_named_with_its_extra(
    fleet: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for package in ("fsspec", "pyarrow", "distributed"):
        monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(MissingPackageError, match=r"fsspec is missing: pip install 'ik_node\[archive\]'"):
        find_bags(["memory://fleet"])
    with pytest.raises(MissingPackageError, match=r"pyarrow is missing: pip install 'ik_node\[archive\]'"):
        table.write_parquet([BagRow("a")], tmp_path / "table.parquet")
    from ik_node.replay.archive.dask_cluster import replay_on_cluster

    with pytest.raises(MissingPackageError, match=r"distributed is missing: pip install 'ik_node\[archive\]'"):
        list(replay_on_cluster([FoundBag("a", "")], QUICK, "tcp://127.0.0.1:1"))


def test_the_page_sorts_by_a_column_and_escapes_texts(tmp_path: Path) -> None:
    """Numbers by value, rows without one last."""
    rows = [
        BagRow("b<script>", verdict="two", cause="tracked", replay=SAME, position_rms_mm=10.5),
        BagRow("c", error="broken"),
        BagRow("a", verdict="one", cause="lag", replay=SAME, position_rms_mm=9.25),
    ]
    page = as_page(rows, ["reports/b.html", "", ""])
    assert "b<script>" not in page
    (tmp_path / "index.html").write_text(page)
    browser = Browser(tmp_path, 400, 800)
    try:
        browser.open((tmp_path / "index.html").as_uri())
        names = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[0].textContent[0]).join('')"
        browser.until("the page", lambda: browser.evaluate(names) == "bca")
        head = "[...document.querySelectorAll('th')].find(e => e.textContent == {!r}).click()"
        browser.evaluate(head.format("bag"))
        assert browser.evaluate(names) == "abc"
        browser.evaluate(head.format("RMS [mm]"))
        assert browser.evaluate(names) == "abc"
        browser.evaluate(head.format("RMS [mm]"))
        assert browser.evaluate(names) == "bac"
        width = browser.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
        assert width, "the table scrolls, the page does not"
        assert browser.errors() == []
    finally:
        browser.close()

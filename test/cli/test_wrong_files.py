"""Files that people give by mistake: one line that names them and exit code 2, from every executable."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from support import PROJECT

from ik_node.cli import config, demo, export, repair, replay, report, solve, view
from ik_node.cli.entry import INTERRUPTED, command_line

BAG = str(PROJECT / "bags" / "plain")
POSE = "0 0 0 0 0 0 1"
COMMANDS: dict[str, tuple[Callable[..., int], tuple[str, ...]]] = {
    "config": (config.main, ("FILE",)),
    "demo --urdf": (demo.main, ("--headless", "--urdf", "FILE")),
    "demo --config": (demo.main, ("--headless", "--config", "FILE")),
    "demo --scene": (demo.main, ("--headless", "--scene", "FILE")),
    "demo --trajectory": (demo.main, ("--headless", "--trajectory", "FILE")),
    "export": (export.main, ("FILE", "out.csv")),
    "repair": (repair.main, ("FILE",)),
    "replay": (replay.main, ("FILE",)),
    "replay --method": (replay.main, ("FILE", "--method", "plain")),
    "replay --robot": (replay.main, ("FILE", "--robot", "panda")),
    "replay --config": (replay.main, ("bag", "--robot", "panda", "--config", "FILE")),
    "report": (report.main, ("FILE",)),
    "report --truth": (report.main, (BAG, "--truth", "FILE")),
    "solve --urdf": (solve.main, ("--urdf", "FILE", "--target", POSE)),
    "view": (view.main, ("FILE",)),
}
NAMES = ("missing", "missing/deep", "folder", "binary", "empty", "text", "binary.mcap", "long" * 1500, "nul\0byte")


@pytest.fixture(autouse=True)
def files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_DOMAIN_ID", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, os.environ.get(name, "1"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "binary").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "binary.mcap").write_bytes(bytes(reversed(range(256))) * 20)
    (tmp_path / "empty").write_text("")
    (tmp_path / "text").write_text("hello: [world\n")


def assert_one_line(main: Callable[..., int], arguments: Sequence[str], capsys: pytest.CaptureFixture[str]) -> str:
    before = set(Path().rglob("*"))
    assert main(list(arguments)) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ")
    assert len(said.err.splitlines()) == 1
    assert said.out == ""
    assert set(Path().rglob("*")) == before
    return str(said.err)


@pytest.mark.parametrize("name", NAMES, ids=lambda name: name[:12].replace("\0", "-"))
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_that_cannot_be_used(command: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    main, arguments = COMMANDS[command]
    assert_one_line(main, [name if word == "FILE" else word for word in arguments], capsys)


@pytest.mark.parametrize("command", ["config", "demo --config", "replay", "solve --urdf"])
def test_a_file_without_permission(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text").chmod(0)
    if os.access(tmp_path / "text", os.R_OK):
        pytest.skip("this user may read every file")
    main, arguments = COMMANDS[command]
    said = assert_one_line(main, ["text" if word == "FILE" else word for word in arguments], capsys)
    assert "Permission denied" in said


@pytest.mark.parametrize(
    ("main", "arguments"),
    [
        (export.main, (BAG, "text/out.csv")),
        (export.main, (BAG, "missing/deep/out.csv")),
        (export.main, (BAG, "nul\0byte.csv")),
        (export.main, (BAG, "folder")),
        (report.main, (BAG, "--out", "text/out.png")),
        (report.main, (BAG, "--out", "folder")),
        (replay.main, (BAG, "--jobs", "-3", "--method", "plain")),
        (view.main, (BAG, "--port", "99999")),
        (demo.main, ("--headless", "--out", "text/out")),
        (demo.main, ("--headless", "--out", "/proc/out")),
        (demo.main, ("--headless", "--out", "nul\0byte")),
        (demo.main, ("--headless", "--out", "long" * 1500)),
        (solve.main, ("--robot", "panda", "--urdf", "text", "--target", POSE)),
    ],
)
def test_places_that_cannot_be_written_and_values_out_of_range(
    main: Callable[..., int], arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert_one_line(main, arguments, capsys)


def test_errors_of_the_system_name_the_file_and_ctrl_c_has_no_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    @command_line
    def full(arguments: object = None) -> int:
        raise OSError(errno.ENOSPC, "No space left on device", "/data/bag")

    @command_line
    def interrupted(arguments: object = None) -> int:
        raise KeyboardInterrupt

    assert full([]) == 2
    assert capsys.readouterr().err == "error: '/data/bag': No space left on device\n"
    assert interrupted([]) == INTERRUPTED

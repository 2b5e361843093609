"""The folder of a demonstration: removed after a failure, kept when only the reader of the output is gone."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.errors import SettingsError
from ik_node.ros.demo.new_folder import new_folder


@pytest.mark.parametrize("failure", [RuntimeError("no robot"), KeyboardInterrupt(), BrokenPipeError()])
def test_a_failure_leaves_nothing(failure: BaseException, tmp_path: Path) -> None:
    with pytest.raises(type(failure)), new_folder(tmp_path / "new" / "run") as folder:
        (folder / "file").write_text("x")
        raise failure
    assert list(tmp_path.iterdir()) == []


def test_a_recording_is_kept_when_the_output_is_closed(tmp_path: Path) -> None:
    with pytest.raises(BrokenPipeError), new_folder(tmp_path / "run") as folder:
        (folder / "bag").mkdir()
        raise BrokenPipeError
    assert (tmp_path / "run" / "bag").is_dir()


def test_an_existing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be created"), new_folder(tmp_path):
        pass

"""Whatever a file holds, the readers answer with an error of this package: metadata, YAML, recordings with mutations.
Nothing outside the folder of a recording is read or repaired."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from support import PROJECT

from ik_node.collision.scene import read_scene
from ik_node.errors import IkNodeError, InputError, RecordingError, SceneError, SettingsError
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.repair import repair
from ik_node.settings.parameter_file import read_settings
from ik_node.settings.yaml_text import MAX_BYTES, load_yaml

HEAD = "rosbag2_bagfile_information:\n  storage_identifier: mcap\n"
BOMB = 'a: &a ["x","x"]\n' + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
TEXTS = (
    b"\xff\xfe\x00binary",
    b"[" * 100_000,
    b"{a: " * 1000,
    BOMB.encode(),
    b"a: !!int ''",
    b"a: !!bool x",
    b"a: 2001-99-99",
    b"a: !!timestamp x",
    b"- a\nb: [",
    b"\0",
    b"",
    b"text",
    b" " * (MAX_BYTES + 1),
)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    directory = tmp_path / "bag"
    directory.mkdir()
    shutil.copy(PROJECT / "bags/plain/plain_0.mcap", directory)
    return directory


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_yaml_of_any_content_is_refused_in_one_line(tmp_path: Path, bag: Path, text: bytes) -> None:
    file = tmp_path / "file.yaml"
    file.write_bytes(text)
    (bag / "metadata.yaml").write_bytes(text)
    for reader, kind in ((read_scene, SceneError), (read_settings, SettingsError)):
        with pytest.raises(kind) as caught:
            reader(file)
        assert "\n" not in str(caught.value)
    with pytest.raises(RecordingError, match="metadata") as told:
        Recording(bag)
    assert "\n" not in str(told.value)


def test_devices_are_read_up_to_the_bound() -> None:
    with pytest.raises(SceneError, match="more than"):
        read_scene("/dev/zero")
    with pytest.raises(SettingsError, match="more than"):
        read_settings(Path("/dev/zero"))


def test_yaml_has_no_aliases() -> None:
    with pytest.raises(InputError, match="aliases"):
        load_yaml("{a: &a [1], b: *a}")


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("  relative_file_paths: [plain_0.mcap]\n  custom_data: text\n", "custom_data"),
        ('  relative_file_paths: ["\\0"]\n', "expected the name"),
        ("  relative_file_paths: [../bag/plain_0.mcap]\n", "expected the name"),
        ("  relative_file_paths: [/dev/zero]\n", "expected the name"),
        ("  relative_file_paths: ['..']\n", "expected the name"),
        ("  relative_file_paths: [[1]]\n", "expected the name"),
        ("  relative_file_paths: [zero.mcap]\n", "leads out"),
        ("  relative_file_paths: [loop.mcap]\n", "cannot be read"),
        (f"  relative_file_paths: [{'x' * 5000}]\n", "cannot be read"),
        ("  relative_file_paths: plain_0.mcap\n", "relative_file_paths"),
        ("", "relative_file_paths"),
    ],
)
def test_metadata_leads_nowhere_else(bag: Path, lines: str, reason: str) -> None:
    (bag / "zero.mcap").symlink_to("/dev/zero")
    (bag / "loop.mcap").symlink_to("loop.mcap")
    (bag / "metadata.yaml").write_text(HEAD + lines)
    with pytest.raises(RecordingError, match=reason):
        Recording(bag)


def test_a_repair_writes_nothing_outside_the_folder(tmp_path: Path, bag: Path) -> None:
    outside = tmp_path / "outside.mcap"
    whole = (bag / "plain_0.mcap").read_bytes()
    outside.write_bytes(whole[: len(whole) // 2])
    before = outside.read_bytes()
    (bag / "plain_0.mcap").unlink()
    (bag / "plain_0.mcap").symlink_to(outside)
    with pytest.raises(RecordingError, match="leads out"):
        repair(bag)
    assert outside.read_bytes() == before


@pytest.mark.parametrize("draws", [40, pytest.param(1000, marks=pytest.mark.exhaustive)])
def test_mutated_recordings_raise_errors_of_this_package(bag: Path, draws: int) -> None:
    chance = random.Random(18)
    file = bag / "plain_0.mcap"
    whole = file.read_bytes()
    for _ in range(draws):
        data = bytearray(whole)
        for _ in range(chance.randrange(1, 6)):
            at = chance.choice(
                [chance.randrange(len(data)), chance.randrange(200), len(data) - chance.randrange(1, 3000)]
            )
            data[at : at + 8] = chance.choice(
                [b"\xff" * 8, b"\0" * 8, chance.randbytes(8), (1 << 62).to_bytes(8, "little")]
            )
        file.write_bytes(data)
        try:
            recording = Recording(bag)
            recording.counts()
            for _message in recording.messages():
                pass
        except IkNodeError as error:
            assert "\n" not in str(error)

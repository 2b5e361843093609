"""Repair of truncated recordings: for every length, every tool opens the repaired file and finds every message that was
in it, and complete files are unchanged. Files that are being written or are damaged otherwise remain untouched. Not
tested: how much a killed writer loses (test_recording.py; `ik_benchmark recording` measures it 20 times)."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
import yaml
from loop import Loop
from made_steps import ROS_START_NS
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap.writer import Writer
from recorded_loop import finish, recorded_loop
from rosbags.highlevel import AnyReader
from test_recording import (
    STEPWISE,
    STRING,
    UNPACKED,
    Written,
    killed,
    metadata_of,
    parts_of,
    read_back,
    write_sample,
)

from ik_node.cli import repair as command
from ik_node.errors import RecordingError
from ik_node.messages import encode
from ik_node.recording.mcap.file import COMPRESSORS
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.mcap.repair import repair
from ik_node.recording.mcap.writer import Recorder, RecorderOptions
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.trajectory.shapes import figure_of_eight


def cut(directory: Path, whole: bytes, length: int, name: str = "bag_0.mcap") -> Path:
    """Return a recording of one file that is truncated after ``length`` bytes."""
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir()
    (directory / name).write_bytes(whole[:length])
    return directory


def assert_whole(directory: Path, wanted: Written) -> None:
    """Check with the package's reader, and with others that need the index, the statistics and metadata.yaml."""
    assert Recording(directory).complete
    assert read_back(directory) == wanted
    information = metadata_of(directory)
    assert information["message_count"] == len(wanted)
    count = 0
    for name, about in zip(information["relative_file_paths"], information["files"], strict=True):
        with (directory / name).open("rb") as stream:
            list(StreamReader(stream, validate_crcs=True).records)
            stream.seek(0)
            reader = make_reader(stream, validate_crcs=True)
            summary = reader.get_summary()
            assert summary is not None
            assert summary.statistics is not None
            indexed = list(reader.iter_messages())
            assert summary.statistics.message_count == len(indexed) == about["message_count"]
            assert summary.statistics.chunk_count == len(summary.chunk_indexes)
            count += len(indexed)
            for metadata in reader.iter_metadata():
                assert "custom_data" in yaml.safe_load(metadata.metadata["serialized_metadata"])
    assert count == len(wanted)
    with AnyReader([directory]) as rosbags:
        assert sorted((c.topic, bytes(data), stamp) for c, stamp, data in rosbags.messages()) == sorted(wanted)


@pytest.mark.parametrize("draws", [8, pytest.param(400, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("compression", sorted(COMPRESSORS))
def test_cut_off_anywhere_it_becomes_whole(tmp_path: Path, compression: str, draws: int) -> None:
    write_sample(tmp_path / "bag", STEPWISE._replace(compression=compression), count=80)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    lengths = random.Random(1).sample(range(60, len(whole)), draws)
    tail = whole.index(b"rosbag2", len(whole) // 2) - 30  # after the last chunk: indexes, metadata, summary
    for length in (*lengths, *range(tail - 120, tail + 60, 13), len(whole) - 1):
        bag = cut(tmp_path / "cut", whole, length)
        wanted = read_back(bag)
        done = repair(bag)
        assert_whole(bag, wanted)
        assert (bag / "bag_0.mcap").read_bytes()[: length - done.parts[0].removed_bytes] == whole[
            : length - done.parts[0].removed_bytes
        ]
        assert done.parts[0].messages == len(wanted)
        after = {path.name: path.read_bytes() for path in bag.iterdir()}
        assert repair(bag).was_complete
        assert {path.name: path.read_bytes() for path in bag.iterdir()} == after


def test_a_repair_that_is_cut_off_itself_can_be_done_again(tmp_path: Path) -> None:
    write_sample(tmp_path / "bag", STEPWISE, count=100)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    bag = cut(tmp_path / "cut", whole, 2 * len(whole) // 3)
    wanted = read_back(bag)
    repair(bag)
    repaired = (bag / "bag_0.mcap").read_bytes()
    for length in range(len(repaired) - 1, 2 * len(whole) // 3, -997):
        bag = cut(tmp_path / "again", repaired, length)
        assert read_back(bag) == wanted
        repair(bag)
        assert_whole(bag, wanted)


def test_of_a_split_recording_only_the_last_file_was_cut_off(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "bag", STEPWISE)
    channel = recorder.channel("/text", STRING)
    for number in range(3000):
        recorder.write(channel, encode.encode_string(f"{number}"), ROS_START_NS + number)
        if number % 100 == 99:
            recorder.write_pending()
        if number % 1000 == 999:
            recorder.split()
    recorder.close()
    bag = tmp_path / "bag"
    (bag / "metadata.yaml").unlink()
    (bag / "bag_3.mcap").write_bytes(b"")  # created before a power failure
    file = bag / "bag_2.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    before = [path.read_bytes() for path in (bag / "bag_0.mcap", bag / "bag_1.mcap")]
    (bag / "bag_3.mcap").unlink()
    wanted = read_back(bag)
    (bag / "bag_3.mcap").write_bytes(b"")
    done = repair(bag)
    assert [part.was_complete for part in done.parts] == [True, True, False]
    assert done.ignored == ("bag_3.mcap",)
    assert [path.read_bytes() for path in (bag / "bag_0.mcap", bag / "bag_1.mcap")] == before
    assert_whole(bag, wanted)
    assert len(parts_of(bag)) == 3


def test_metadata_alone_is_written_anew(tmp_path: Path) -> None:
    written = write_sample(tmp_path / "bag", count=20)
    before = metadata_of(tmp_path / "bag")
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    (tmp_path / "bag" / "metadata.yaml").unlink()
    done = repair(tmp_path / "bag")
    assert done.parts[0].was_complete
    assert not done.was_complete
    assert (tmp_path / "bag" / "bag_0.mcap").read_bytes() == data
    assert_whole(tmp_path / "bag", written)
    after = metadata_of(tmp_path / "bag")
    assert {**after, "custom_data": None} == {**before, "custom_data": None}
    assert after["custom_data"]["made_by"] == "test"


def test_one_file_alone_is_repaired(tmp_path: Path) -> None:
    write_sample(tmp_path / "bag", STEPWISE, count=50)
    file = tmp_path / "alone.mcap"
    file.write_bytes((tmp_path / "bag" / "bag_0.mcap").read_bytes()[:-2500])
    wanted = read_back(file)
    repair(file)
    assert Recording(file).complete
    assert read_back(file) == wanted
    assert repair(file).was_complete


def test_zeros_that_a_power_cut_leaves_at_the_end_are_removed(tmp_path: Path) -> None:
    write_sample(tmp_path / "bag", STEPWISE, count=50)
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    for length in range(2000, len(whole), 997):
        bag = cut(tmp_path / "cut", whole[:length], length)
        wanted = read_back(bag)
        bag = cut(tmp_path / "cut", whole[:length] + bytes(4096), length + 4096)
        assert repair(bag).parts[0].removed_bytes >= 4090
        assert_whole(bag, wanted)


def test_recordings_of_others_are_repaired_too(tmp_path: Path) -> None:
    """Written by the mcap library, as most Python tools do: channels inside chunks, other numbers."""
    file = tmp_path / "theirs.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream, chunk_size=2000)
        writer.start("ros2")
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        channels = [writer.register_channel(f"/text{number}", "cdr", schema) for number in range(3)]
        for number in range(300):
            writer.add_message(channels[number % 3], ROS_START_NS + number, encode.encode_string("x" * 50), number)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap has no annotations
    whole = file.read_bytes()
    for length in range(200, len(whole), len(whole) // 20):
        file.write_bytes(whole[:length])
        wanted = read_back(file)
        repair(file)
        assert read_back(file) == wanted
        with file.open("rb") as stream:
            assert len(list(make_reader(stream, validate_crcs=True).iter_messages())) == len(wanted)


# --- files that remain untouched ---


def assert_untouched(path: Path, reason: str) -> None:
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    with pytest.raises(RecordingError, match=reason):
        repair(path)
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before


def test_what_is_being_written_is_left_alone(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "bag", STEPWISE)
    channel = recorder.channel("/text", STRING)
    recorder.write(channel, encode.encode_string("x"), ROS_START_NS)
    recorder.write_pending()
    assert_untouched(tmp_path / "bag", "is being written")
    recorder.close()
    assert recorder.error == ""
    assert repair(tmp_path / "bag").was_complete


def test_what_is_damaged_before_its_end_is_left_alone(tmp_path: Path) -> None:
    write_sample(tmp_path / "bag", UNPACKED)
    file = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(b"text 7 ")] ^= 1
    file.write_bytes(bytes(data[:-50]))
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert_untouched(tmp_path / "bag", r"is damaged after byte \d+, not cut off")


def test_what_is_no_recording_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x_0.mcap").write_bytes(b"something else entirely")
    assert_untouched(tmp_path, "is no MCAP file")
    (tmp_path / "x_0.mcap").write_bytes(b"")
    assert_untouched(tmp_path, "contains nothing that can be repaired")
    assert command.main([str(tmp_path / "nothing")]) == 2
    assert "does not exist" in capsys.readouterr().err


# --- runs ---


def moved_loop(directory: Path) -> Loop:
    loop = recorded_loop(directory, {"rate_hz": 200.0}, options=RecorderOptions(flush_period_s=0.05))
    for _ in range(5):
        loop.follow(figure_of_eight(loop.pose()).pose, 0.3, 50.0)
    finish(loop)
    return loop


def test_a_repaired_run_replays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Up to the truncation: a call whose Step was not written does not count as a difference."""
    moved_loop(tmp_path / "bag")
    whole = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    for part in (0.5, 0.7, 0.9):
        bag = cut(tmp_path / "cut", whole, round(part * len(whole)))
        before = replay(RecordingSource(bag))
        assert command.main([str(bag)]) == 0
        said = capsys.readouterr().out
        assert "was cut off" in said
        assert "lost: " in said
        after = replay(RecordingSource(bag))
        assert after.first is None
        assert (after.steps, after.calls) == (before.steps, before.calls)
        assert after.steps > 20


def test_left_out_messages_are_counted_by_their_gaps(tmp_path: Path) -> None:
    """A killed writer reports no dropped messages, so they are counted by sequence numbers."""
    loop = recorded_loop(
        tmp_path / "bag", {"rate_hz": 200.0}, options=RecorderOptions(queue_mb=0.1, flush_period_s=0.6)
    )
    for _ in range(2):
        loop.follow(figure_of_eight(loop.pose()).pose, 0.6, 50.0)
    loop.run(0.02)
    dropped = finish(loop).dropped
    assert dropped > 0
    file = tmp_path / "bag" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-10])
    (tmp_path / "bag" / "metadata.yaml").unlink()
    done = repair(tmp_path / "bag")
    assert 0 < done.parts[0].missing <= dropped
    assert metadata_of(tmp_path / "bag")["custom_data"]["dropped"] == str(done.parts[0].missing)


def test_killed_and_repaired(tmp_path: Path) -> None:
    """End to end: a process that is killed while it records."""
    with killed(tmp_path / "bag", "no thread"):
        pass
    wanted = read_back(tmp_path / "bag")
    assert [time_ns for _, _, time_ns in wanted] == [*range(1, 301)]
    repair(tmp_path / "bag")
    assert_whole(tmp_path / "bag", wanted)

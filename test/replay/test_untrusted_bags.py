"""Bags of others, whatever they hold, are replayed or refused in one line. Not tested here: what the replay of a good
bag gives (test_bags.py)."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer
from recorded_loop import finish, recorded_loop
from support import PROJECT, shared_path

from ik_node.errors import IkNodeError, RecordingError
from ik_node.interfaces.clock import NS
from ik_node.messages.cdr import STORE
from ik_node.messages.encode import encode_joint_state
from ik_node.recording.call_log import RecordedCall
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.external_bag import ExternalBag
from ik_node.settings.groups import Settings
from ik_node.trajectory.shapes import figure_of_eight

JOINT_STATE = "sensor_msgs/msg/JointState"
START_NS = 1_700_000_000 * NS
COUNT = 30
JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])


def write_bag(directory: Path, last_ns: int = 0, extra: str = "") -> Path:
    """Joint states every 2 ms, the last one ``last_ns`` later; ``extra``: encoding of one more topic."""
    directory.mkdir()
    times = [START_NS + number * 2_000_000 for number in range(COUNT)]
    times[-1] += last_ns
    with (directory / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        definition, _ = STORE.generate_msgdef(JOINT_STATE, ros_version=2)
        states = writer.register_channel(
            "/joint_states", "cdr", writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        )
        if extra:
            other = writer.register_channel(
                "/other", extra, writer.register_schema("some.Type", f"{extra}schema", b"{}")
            )
            writer.add_message(other, times[3], b'{"a":1}', times[3])
        for time_ns in times:
            writer.add_message(states, time_ns, encode_joint_state(JOINTS, time_ns, Q), time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    topics = [("/joint_states", JOINT_STATE, "cdr", COUNT)] + ([("/other", "some.Type", extra, 1)] if extra else [])
    write_metadata(
        directory,
        {
            "version": 5,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": times[-1] - times[0]},
            "starting_time": {"nanoseconds_since_epoch": times[0]},
            "message_count": sum(topic[-1] for topic in topics),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": name,
                        "type": kind,
                        "serialization_format": encoding,
                        "offered_qos_profiles": "",
                    },
                    "message_count": count,
                }
                for name, kind, encoding, count in topics
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": ["bag_0.mcap"],
        },
    )
    return directory


def write_metadata(directory: Path, content: Any) -> None:
    (directory / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))


def change_metadata(directory: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    content = yaml.safe_load((directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    change(content)
    write_metadata(directory, content)


def opened(path: Path) -> ExternalBag:
    return ExternalBag(path, Settings().with_values({"robot": "panda"}))


def number_of_states(path: Path) -> int:
    return sum(bool(entry.data) for entry in opened(path).entries())


@pytest.mark.parametrize("extra", ["", "json", "protobuf"])
def test_topics_of_other_encodings_are_skipped(tmp_path: Path, extra: str) -> None:
    assert number_of_states(write_bag(tmp_path / "bag", extra=extra)) == COUNT


CHANGES: tuple[Callable[[dict[str, Any]], Any], ...] = (
    lambda content: content.update(storage_identifier=""),
    lambda content: content.pop("storage_identifier"),
    lambda content: content.pop("duration"),
    lambda content: content.pop("relative_file_paths"),
    lambda content: content.update(relative_file_paths=7),
)


@pytest.mark.parametrize("change", CHANGES, ids=range(len(CHANGES)))
def test_a_single_file_is_opened_without_usable_metadata(tmp_path: Path, change: Any) -> None:
    bag = write_bag(tmp_path / "bag")
    change_metadata(bag, change)
    assert number_of_states(bag) == COUNT
    shutil.copy(bag / "bag_0.mcap", bag / "bag_1.mcap")
    with pytest.raises(RecordingError, match="ros2 bag reindex"):
        opened(bag)


def test_a_single_file_is_opened_without_metadata(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    (bag / "metadata.yaml").unlink()
    assert number_of_states(bag) == COUNT


@pytest.mark.parametrize("name", ["../bag_0.mcap", "/dev/zero", "zero.mcap", 3, ""])
def test_no_name_leads_out_of_the_folder(tmp_path: Path, name: object) -> None:
    bag = write_bag(tmp_path / "bag")
    (bag / "zero.mcap").symlink_to("/dev/zero")
    change_metadata(bag, lambda content: content.update(relative_file_paths=[name]))
    with pytest.raises(RecordingError, match=r"expected the name|leads out"):
        opened(bag)


@pytest.mark.parametrize("gap_s", [100.0, 3e8])
def test_a_gap_makes_a_bounded_number_of_calls(tmp_path: Path, gap_s: float) -> None:
    entries = list(opened(write_bag(tmp_path / "bag", last_ns=round(gap_s * NS))).entries())
    assert len(entries) < 6_500
    times = [entry.call.now.monotonic_ns for entry in entries]
    assert times == sorted(times)
    assert times[-1] - times[-2] < 10_000_000, "the clock calls of the end of the gap"


@pytest.mark.parametrize("draws", [60, pytest.param(1000, marks=pytest.mark.exhaustive)])
def test_mutated_bags_are_replayed_or_refused_in_one_line(tmp_path: Path, draws: int) -> None:
    chance = random.Random(18)
    bag = write_bag(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    whole = file.read_bytes()
    refused = 0
    for _ in range(draws):
        data = bytearray(whole)
        for _ in range(chance.randrange(1, 4)):
            at = chance.choice([chance.randrange(len(data)), len(data) - chance.randrange(1, min(1500, len(data)))])
            new = chance.choice([b"\xff" * 8, b"\0" * 8, chance.randbytes(8), (1 << 62).to_bytes(8, "little")])
            data[at : at + 8] = new
        file.write_bytes(data)
        try:
            for _entry in opened(bag).entries():
                pass
        except IkNodeError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused > draws // 5


@pytest.mark.parametrize("number", [1, 2, 3, 20])
def test_the_mutated_bags_that_were_reported(tmp_path: Path, number: int) -> None:
    shutil.copy(
        shared_path("fault_cases", "10-foreign-bag-tracebacks", f"mcapbad_{number}.mcap"), tmp_path / "limit_0.mcap"
    )
    shutil.copy(PROJECT / "bags/limit/metadata.yaml", tmp_path)
    with pytest.raises(RecordingError, match=r"cannot be read as a bag|damaged"):
        for _entry in opened(tmp_path).entries():
            pass


def test_a_recording_that_lost_its_sequence_numbers(tmp_path: Path) -> None:
    """As `ros2 bag convert` leaves it: parameters, targets and calls are those of the original."""
    loop = recorded_loop(tmp_path / "bag", {"rate_hz": 100.0})
    for gain in (3.0, 4.0, 5.0):
        loop.follow(figure_of_eight(loop.pose()).pose, 0.3, 50.0)
        controller: Any = loop.controller
        controller.apply(loop.controller.settings.with_values({"gain": (gain, gain)}), loop.now)
    loop.run(0.1)
    finish(loop)
    (original,) = (tmp_path / "bag").glob("*.mcap")
    converted = tmp_path / "converted_0.mcap"
    with original.open("rb") as stream, converted.open("wb") as out:
        writer = Writer(out)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                register = partial(writer.register_channel, channel.topic, channel.message_encoding)
                channels[channel.id] = register(schemas[schema.id], channel.metadata)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    one, other = load_run(original), load_run(converted)
    assert one.setting_changes == other.setting_changes
    assert len(one.setting_changes) == 3
    np.testing.assert_allclose(one.targets.times_s, other.targets.times_s, atol=0.01)
    entries = [list(RecordingSource(path).entries()) for path in (original, converted)]
    assert [entry for entry in entries[0] if isinstance(entry, RecordedCall)] == [
        entry for entry in entries[1] if isinstance(entry, RecordedCall)
    ]
    found = replay(RecordingSource(converted))
    assert found.first is None
    assert found.steps == replay(RecordingSource(original)).steps > 50

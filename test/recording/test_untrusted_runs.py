"""What a recording claims about its run is checked where it is read. Found by test/fuzz; files of any content:
test_untrusted_files.py."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_steps import made_step
from support import PROJECT

from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import NS
from ik_node.messages.cdr import STORE, deserialize, make, serialize, time_message
from ik_node.messages.decode import decode_string
from ik_node.messages.restamp import restamped
from ik_node.messages.step_codec import STEP_TYPE, StepDecoder, StepEncoder
from ik_node.recording.call_log import decode_snapshot, read_setup
from ik_node.recording.mcap.reader import Recording
from ik_node.recording.run_reader import load_run

BAG = PROJECT / "bags" / "plain"


def setup_of_a_run() -> dict[str, Any]:
    texts = [decode_string(one.data) for one in Recording(BAG).messages() if one.topic.endswith("/setup")]
    content: dict[str, Any] = json.loads(texts[0])
    return content


CHANGES: tuple[Callable[[dict[str, Any]], Any], ...] = (
    lambda setup: setup.pop("inputs"),
    lambda setup: setup.update(inputs=["target_pose"]),
    lambda setup: setup.update(inputs={"target_pose": 3}),
    lambda setup: setup.pop("limits"),
    lambda setup: setup["limits"].pop("upper"),
    lambda setup: setup["limits"].update(velocity=[1.0]),
    lambda setup: setup["limits"].update(velocity=["a"] * 7),
    lambda setup: setup["limits"].update(velocity=[10**400] * 7),
    lambda setup: setup.update(joints="abcdefg"),
    lambda setup: setup.update(joints=[1, 2, 3, 4, 5, 6, 7]),
    lambda setup: setup.update(robot=None),
    lambda setup: setup.update(versions=[]),
    lambda setup: setup.pop("geometry"),
    lambda setup: setup.pop("format"),
)


@pytest.mark.parametrize("change", CHANGES, ids=range(len(CHANGES)))
def test_a_setup_of_other_types_is_refused(change: Callable[[dict[str, Any]], Any]) -> None:
    setup = setup_of_a_run()
    read_setup(json.dumps(setup))
    change(setup)
    with pytest.raises(RecordingError, match="the setup of a run cannot be read"):
        read_setup(json.dumps(setup))


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "3", "", '{"format": 2}'])
def test_a_setup_of_other_text_is_refused(text: str) -> None:
    with pytest.raises(RecordingError, match="the setup of a run cannot be read"):
        read_setup(text)


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "null", '{"cycle": {"tick": 1e999}}', '{"cycle": []}'])
def test_a_snapshot_of_other_text_is_refused(text: str) -> None:
    with pytest.raises(RecordingError, match="another version"):
        decode_snapshot(text, ControllerSnapshot)


@pytest.mark.parametrize("dropped", ["many", "''", "1.5", "[1]"])
def test_a_number_of_dropped_messages_that_is_none(tmp_path: Path, dropped: str) -> None:
    bag = shutil.copytree(BAG, tmp_path / "bag")
    metadata = bag / "metadata.yaml"
    text, count = re.subn(r"dropped: .*", f"dropped: {dropped}", metadata.read_text())
    assert count >= 1
    metadata.write_text(text)
    with pytest.raises(RecordingError, match=r"custom_data.dropped is .*; expected a number"):
        load_run(bag)


def changed_step(message: bytes, label: str, value: float) -> bytes:
    step = deserialize(message, STEP_TYPE)
    step.data, begin = step.data.copy(), 0
    for dimension in step.layout.dim:
        if dimension.label == label:
            step.data[begin] = value
        begin += dimension.size
    return serialize(step)


def resized_step(message: bytes, label: str, size: int) -> bytes:
    step = deserialize(message, STEP_TYPE)
    for dimension in step.layout.dim:
        if dimension.label == label:
            step.data = np.append(step.data, np.zeros(size - dimension.size))
            dimension.size = size
    return serialize(step)


@pytest.mark.parametrize("label", ["tick", "now_monotonic", "now_ros", "state_time", "texts"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -1e300])
def test_a_step_with_a_counter_or_time_that_is_none(label: str, value: float) -> None:
    decoder = StepDecoder()
    texts, message = StepEncoder("/ik_node", 7).encode(made_step(0, 7))
    assert texts is not None
    decoder.texts(texts)
    decoder.step(message)
    with pytest.raises(RecordingError, match="no counter or time"):
        decoder.step(changed_step(message, label, value))


@pytest.mark.parametrize("seconds", [2**31 - 1, -(2**31)])
def test_a_stamp_that_is_shifted_out_of_its_field(seconds: int) -> None:
    data = serialize(make("std_msgs/msg/Header", stamp=time_message(seconds * NS), frame_id=""))
    restamped(data, "std_msgs/msg/Header", 0)
    with pytest.raises(InputError, match="does not fit into a std_msgs/msg/Header"):
        restamped(data, "std_msgs/msg/Header", NS if seconds > 0 else -NS)


def test_a_step_of_another_layout() -> None:
    decoder = StepDecoder()
    texts, message = StepEncoder("/ik_node", 7).encode(made_step(0, 7))
    assert texts is not None
    decoder.texts(texts)
    big_endian = bytes(STORE.serialize_cdr(deserialize(message, STEP_TYPE), STEP_TYPE, little_endian=False))
    for first in (False, True):  # also with the layout of a valid one remembered
        if first:
            decoder.step(message)
        for other, reason in (
            (message + bytes(8), "mismatch|more bytes than its layout"),
            (message + bytes(3), "mismatch|more bytes than its layout"),
            (big_endian, "big-endian"),
            (message[:-8], "bytes are no"),
            (resized_step(message, "tick", 2), "slice tick .* has 2 numbers, expected 1"),
        ):
            with pytest.raises((RecordingError, ValueError), match=reason):
                decoder.step(other)

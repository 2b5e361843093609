"""Bags, recordings, scenes, parameter files and pose files of any content: exit code 2, one line, no traceback."""

from __future__ import annotations

import http.client
import shutil
import struct
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml
from command_lines import one_line
from fault import choose
from fault_table import Row, failures
from mcap.reader import make_reader
from mcap.writer import Writer
from support import PROJECT
from waiting import ENOUGH_S

from ik_node.messages.cdr import STORE
from ik_node.messages.encode import encode_joint_state

PLAIN = PROJECT / "bags" / "plain"
SHARED = PROJECT.parent / "shared" / "fault_cases"
JOINT_STATE = "sensor_msgs/msg/JointState"
JOINTS = tuple(f"panda_joint{number}" for number in range(1, 8))
Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])
HEAD = "rosbag2_bagfile_information:\n  storage_identifier: mcap\n"
BOMB = 'a: &a ["x","x"]\n' + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
START_NS = 1_700_000_000 * 10**9

Make = Callable[[Path], list[str]]
"""Makes files in a folder; returns the command line."""


class FileFault(NamedTuple):
    """Files, a command that reads them, and what has to be said."""

    name: str
    make: Make
    text: str
    """Part of the error; empty when the input has to be taken."""
    case: str = ""


# --- own recordings --------------------------------------------------------------------------------------------------


def own(folder: Path, metadata: str | bytes | None, *command: str) -> list[str]:
    """A command on a recording of this package with other metadata; None: with its own."""
    bag = folder / "bag"
    shutil.copytree(PLAIN, bag)
    if metadata is not None:
        (bag / "metadata.yaml").write_bytes(metadata if isinstance(metadata, bytes) else metadata.encode())
    return [*command, str(bag)]


def text_as_custom_data(folder: Path, command: str) -> list[str]:
    return own(folder, HEAD + "  relative_file_paths: [plain_0.mcap]\n  custom_data: text\n", command)


def changed(folder: Path, change: Callable[[bytes], bytes], *command: str) -> list[str]:
    """A command on a recording with other bytes."""
    arguments = own(folder, None, *command)
    file = folder / "bag" / "plain_0.mcap"
    file.write_bytes(change(file.read_bytes()))
    return arguments


def without_sequence(folder: Path) -> list[str]:
    """What ``ros2 bag convert`` leaves of a recording: all sequence numbers are 0."""
    arguments = own(folder, None, "replay")
    file = folder / "bag" / "plain_0.mcap"
    with (PLAIN / "plain_0.mcap").open("rb") as stream, file.open("wb") as output:
        writer = Writer(output)
        writer.start("ros2")
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                number = writer.register_channel(channel.topic, channel.message_encoding, schemas[schema.id])
                channels[channel.id] = number
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return arguments


# --- bags of others --------------------------------------------------------------------------------------------------


def others(
    folder: Path, extra: str = "", last_s: float = 0.0, change: Callable[[dict[str, Any]], object] | None = None
) -> list[str]:
    """Replay of a bag of another program.

    Args:
        folder: For the bag.
        extra: Encoding of one more topic.
        last_s: The last message is later by this time.
        change: Changes the content of ``metadata.yaml``; None when the file is left out.
    """
    bag = folder / "bag"
    bag.mkdir()
    times = [START_NS + number * 2_000_000 for number in range(30)]
    times[-1] += round(last_s * 1e9)
    with (bag / "bag_0.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        definition, _ = STORE.generate_msgdef(JOINT_STATE, ros_version=2)
        schema = writer.register_schema(JOINT_STATE, "ros2msg", definition.encode())
        states = writer.register_channel("/joint_states", "cdr", schema)
        if extra:
            other = writer.register_channel("/o", extra, writer.register_schema("some.Type", f"{extra}schema", b"{}"))
            writer.add_message(other, times[3], b'{"a":1}', times[3])
        for time_ns in times:
            writer.add_message(states, time_ns, encode_joint_state(JOINTS, time_ns, Q), time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    if change is not None:
        kind = {"name": "/joint_states", "type": JOINT_STATE, "serialization_format": "cdr", "offered_qos_profiles": ""}
        content = {
            "version": 5,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": times[-1] - times[0]},
            "starting_time": {"nanoseconds_since_epoch": times[0]},
            "message_count": 30,
            "topics_with_message_count": [{"topic_metadata": kind, "message_count": 30}],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": ["bag_0.mcap"],
        }
        change(content)
        (bag / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": content}))
    return ["replay", str(bag), "--robot", "panda", "--jobs", "1"]


def unchanged(content: dict[str, Any]) -> None:
    del content


def set_value(key: str, value: object) -> Callable[[dict[str, Any]], None]:
    def change(content: dict[str, Any]) -> None:
        content[key] = value
        if value is None:
            del content[key]

    return change


def mutated(folder: Path, number: int) -> list[str]:
    """A mutated MCAP file that was reported."""
    file = SHARED / "10-foreign-bag-tracebacks" / f"mcapbad_{number}.mcap"
    if not file.exists():
        return []
    bag = folder / "bag"
    bag.mkdir()
    shutil.copy(file, bag / "limit_0.mcap")
    shutil.copy(PROJECT / "bags" / "limit" / "metadata.yaml", bag)
    return ["replay", str(bag), "--robot", "panda"]


# --- other files -----------------------------------------------------------------------------------------------------


def scene(folder: Path, content: bytes) -> list[str]:
    (folder / "scene.yaml").write_bytes(content)
    return ["demo", "--out", str(folder / "run"), "--scene", str(folder / "scene.yaml")]


def parameters(folder: Path, content: bytes) -> list[str]:
    (folder / "p.yaml").write_bytes(content)
    return ["demo", "--out", str(folder / "run"), "--config", str(folder / "p.yaml")]


def poses(folder: Path, name: str, content: bytes) -> list[str]:
    (folder / name).write_bytes(content)
    return ["demo", "--out", str(folder / "run"), "--trajectory", str(folder / name)]


def npy(header: str, data: bytes = b"") -> bytes:
    text = header.encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


MUTATED = (1, 2, 3, 20)
FAULTS = (
    FileFault("own recording", lambda f: own(f, None, "replay"), ""),
    *(
        FileFault(f"custom_data is text, ik_{name}", partial(text_as_custom_data, command=name), "custom_data", "F11")
        for name in ("report", "replay", "repair")
    ),
    FileFault("NUL in a file name", lambda f: own(f, HEAD + '  relative_file_paths: ["\\0"]\n', "report"),
              "expected the name", "F11"),
    FileFault("../ in a file name", lambda f: own(f, HEAD + "  relative_file_paths: [../bag/plain_0.mcap]\n", "report"),
              "expected the name", "F11"),
    FileFault("absolute file name", lambda f: own(f, HEAD + "  relative_file_paths: [/dev/zero]\n", "report"),
              "expected the name", "F11"),
    FileFault("YAML aliases in the metadata", lambda f: own(f, BOMB, "report"), "aliases", "F11"),
    FileFault("binary metadata", lambda f: own(f, b"\xff\xfe\x00binary", "report"), "metadata", "F11"),
    FileFault("empty metadata", lambda f: own(f, "", "report"), "metadata"),
    FileFault("a tenth of a recording", lambda f: changed(f, lambda b: b[: len(b) // 10], "report"), "holds no run"),
    FileFault("a recording of zeros", lambda f: changed(f, lambda b: bytes(len(b)), "report"), "bag"),
    FileFault("an empty recording", lambda f: changed(f, lambda b: b"", "report"), "bag"),
    FileFault("a text as recording", lambda f: changed(f, lambda b: b"text\n" * 100, "replay"), "bag"),
    FileFault("no sequence numbers", without_sequence, "", "W15"),
    FileFault("no such bag", lambda f: ["report", str(f / "none")], "none"),
    FileFault("bag of others", lambda f: others(f, change=unchanged), ""),
    FileFault("topic in JSON", lambda f: others(f, "json", change=unchanged), "", "W14"),
    FileFault("topic in protobuf", lambda f: others(f, "protobuf", change=unchanged), "", "W14"),
    FileFault("no metadata.yaml", others, "", "W14"),
    FileFault("storage_identifier empty", lambda f: others(f, change=set_value("storage_identifier", "")), "", "W14"),
    FileFault("no duration", lambda f: others(f, change=set_value("duration", None)), "", "W14"),
    FileFault("last message 10 years later", lambda f: others(f, last_s=3e8, change=unchanged), "", "F10"),
    *(FileFault(f"mutated bag {n}", partial(mutated, number=n), "cannot be read as a bag", "F10") for n in MUTATED),
    FileFault("scene: binary", lambda f: scene(f, b"\xff\xfe\x00binary"), "scene", "F14"),
    FileFault("scene: aliases", lambda f: scene(f, BOMB.encode()), "aliases", "F14"),
    FileFault("scene: no list", lambda f: scene(f, b"a: 1"), "obstacles", "F14"),
    FileFault("parameter file: binary", lambda f: parameters(f, b"\xff\xfe\x00binary"), "p.yaml", "F14"),
    FileFault("parameter file: aliases", lambda f: parameters(f, BOMB.encode()), "aliases", "F14"),
    FileFault("NPY: deep header", lambda f: poses(f, "a.npy", npy("(" * 60_000)), "a.npy", "F14"),
    FileFault("NPY: 5 TiB claimed", lambda f: poses(f, "a.npy", npy(
        "{'descr': '<f8', 'fortran_order': False, 'shape': (100000000000, 7), }\n")), "a.npy", "F14"),
    FileFault("CSV: binary", lambda f: poses(f, "a.csv", b"\xff\xfe\x00\x01" * 50), "a.csv", "F14"),
    FileFault("CSV: empty", lambda f: poses(f, "a.csv", b""), "a.csv"),
)  # fmt: skip


def test_files(tmp_path: Path, pytestconfig: pytest.Config, record_property: Callable[[str, object], None]) -> None:
    rows = []
    for number, fault in enumerate(choose(pytestconfig, "files", FAULTS, 4)):
        folder = tmp_path / str(number)
        folder.mkdir()
        arguments = fault.make(folder)
        if not arguments:  # the file is not beside this checkout
            continue
        last, code, wrong = one_line(arguments, fault.text)
        last = last.replace(f"{folder}/", "")
        rows.append(Row(fault.name, fault.case, f"ik_{arguments[0]}", "-", "-", "-", "-", last, code, wrong))
    record_property("fault_rows", [list(row) for row in rows])
    assert not failures(rows), "\n".join(failures(rows))


def test_other_origins(record_property: Callable[[str, object], None]) -> None:
    """A page of another origin gets no answer of the viewer; test/viewer/test_server.py has further cases."""
    pytest.importorskip("viser")
    from ik_node.viewer.server import serve

    server = serve(0)
    rows = []
    try:
        for host, origin, expected in (
            ("localhost", "", 200),
            ("evil.example", "", 403),
            ("", "http://evil.example", 403),
        ):
            connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=ENOUGH_S)
            headers = {"Host": host or f"localhost:{server.get_port()}", **({"Origin": origin} if origin else {})}
            connection.request("GET", "/", headers=headers)
            found = connection.getresponse().status
            wrong = "" if found == expected else f"status {found}; expected {expected}"
            name = f"page of {origin or host}"
            rows.append(Row(name, "F12", "ik_view", "-", "-", "-", "-", f"HTTP status {found}", "-", wrong))
    finally:
        server.stop()
    record_property("fault_rows", [list(row) for row in rows])
    assert not failures(rows), "\n".join(failures(rows))

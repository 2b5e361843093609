"""Parameters of the simulated arm and of the watchdog are declared as those of the node: types, names, files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from ros_peer import Peer, peer_in_own_domain

REFUSED = (
    ("watchdog", "timeout_ms:=5.0", "unknown parameter 'timeout_ms'; nearest: timeout_s"),
    ("watchdog", "timeout_s:=0.001", "timeout_s is 0.001; valid: 0.01 to 10 s"),
    ("watchdog", "timeout_s:=soon", "timeout_s is 'soon' (string); valid: a double, 0.01 to 10 s"),
    ("simulator", "rate:=100.0", "unknown parameter 'rate'; nearest: rate_hz"),
    ("simulator", "initial_position:=[0, 1.5]", "initial_position of ik_simulator has 2 values; expected 7"),
    ("simulator", "dropout:=2", "dropout is 2.0; valid: 0 to 1"),
)
ACCEPTED = (
    ("watchdog", ["timeout_s:=1"], "after 1 s"),
    ("simulator", ["rate_hz:=100", "initial_position:=[0, 0, 0, -1.5, 0, 1, 0]", "lag_s:=0"], ""),
)
OF_ANOTHER = "/**:\n  other:\n    ros__parameters:\n      rate_hz: 3\n"


@pytest.fixture
def peer() -> Iterator[Peer]:
    with peer_in_own_domain() as found:
        yield found


@pytest.mark.parametrize(("executable", "value", "reason"), REFUSED, ids=[value for _, value, _ in REFUSED])
def test_refused_in_one_line(peer: Peer, tmp_path: Path, executable: str, value: str, reason: str) -> None:
    process = peer.start(executable, tmp_path, ["-p", value])
    peer.until("the end", lambda: process.exit_code is not None)
    assert process.exit_code == 1
    (line,) = process.log.read_text().splitlines()
    assert line.startswith(f"error: {reason}")


@pytest.mark.parametrize("executable", ["watchdog", "simulator"])
def test_an_unknown_name_in_a_file_is_refused(peer: Peer, tmp_path: Path, executable: str) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(OF_ANOTHER.replace("other", f"ik_{executable}").replace("rate_hz", "no_such_name"))
    process = peer.start(executable, tmp_path, ["--params-file", str(file)])
    peer.until("the end", lambda: process.exit_code is not None)
    assert process.exit_code == 1
    assert "error: unknown parameter 'no_such_name'" in process.log.read_text()


@pytest.mark.parametrize(("executable", "values", "logged"), ACCEPTED, ids=[name for name, _, _ in ACCEPTED])
def test_whole_numbers_are_taken_and_a_file_for_another_node_is_reported(
    peer: Peer, tmp_path: Path, executable: str, values: list[str], logged: str
) -> None:
    file = tmp_path / "parameters.yaml"
    file.write_text(OF_ANOTHER)
    given = ["--params-file", str(file), *(part for value in values for part in ("-p", value))]
    if executable == "watchdog":
        peer.start("simulator", tmp_path, [])
        peer.start("node", tmp_path, ["-p", "robot:=panda"])
    process = peer.start(executable, tmp_path, given)
    line = f"'{file}' has no parameters for node /ik_{executable}; it has some for /**/other"
    peer.until(line, lambda: line in process.log.read_text())
    peer.until(
        "its work", lambda: logged in process.log.read_text() and peer.node.count_publishers("/joint_states") > 1
    )
    assert process.exit_code is None

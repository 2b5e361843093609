"""Options of ik_demo that are refused before any process starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.cli.demo import main


@pytest.mark.parametrize(
    ("assignment", "reason"),
    [
        ("gain_liner=3", "unknown parameter 'gain_liner'; nearest: gain"),
        ("gain=fast", "gain is 'fast' (string); valid: a list of 2 doubles"),
        ("state.timeout_s=-1", "state.timeout_s is -1.0; valid: "),
        ("gain", "'gain' is no assignment; expected NAME=VALUE"),
    ],
)
def test_set_is_checked_by_the_demonstration_itself(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], assignment: str, reason: str
) -> None:
    out = tmp_path / "out"
    assert main(["--headless", "--out", str(out), "--set", assignment]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert output.err.startswith(f"error: {reason}")
    assert output.err.count("\n") == 1
    assert not out.exists()

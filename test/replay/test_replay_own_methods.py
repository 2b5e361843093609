"""Own methods in recordings: the replay uses the method of the same name, and says when it is absent or another one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from loop import Loop
from recorded_loop import RecordedCaller, finish, recorded_loop

from ik_node.errors import InputError, SettingsError
from ik_node.messages.step_codec import CallKind
from ik_node.recording.run_reader import load_run
from ik_node.replay.bitwise import Comparison, replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.closed_loop import simulate
from ik_node.replay.text import as_plain, as_text
from ik_node.replay.what_if import make_variants
from ik_node.trajectory.shapes import figure_of_eight

MODULE = "method_of_a_user"
NAME = f"{MODULE}:cost"
SOURCE = """
import numpy as np

def cost(robot, q):
    if 0.01 < abs(q[3] + 2.356194) < 0.03:
        raise ValueError("too far")
    return np.diag(1.0 + q * q), {factor} * q
"""


class Home:
    """A folder of modules of the user on the path of Python."""

    def __init__(self, folder: Path, patch: pytest.MonkeyPatch) -> None:
        folder.mkdir()
        self._file = folder / f"{MODULE}.py"
        self._patch = patch
        patch.syspath_prepend(str(folder))

    def write(self, factor: float | None) -> None:
        """Writes the module; None removes it."""
        self._patch.delitem(sys.modules, MODULE, raising=False)
        self._file.unlink(missing_ok=True)
        if factor is not None:
            self._file.write_text(SOURCE.format(factor=factor) + f"# {'x' * int(factor)}\n")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Home:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    found = Home(tmp_path / "home", monkeypatch)
    found.write(20.0)
    return found


def recorded(directory: Path, method: str = NAME) -> Loop:
    """A run with the method, without and with its fault."""
    loop = recorded_loop(directory, {"method": method, "rate_hz": 200.0})
    loop.run(0.05)
    loop.follow(figure_of_eight(loop.pose()).pose, 2.0, 50.0)
    finish(loop)
    return loop


def texts(directory: Path) -> tuple[Comparison, str]:
    source = RecordingSource(directory)
    found = replay(source)
    assert found.steps > 0
    return found, as_text(source, found, 1.0)


def test_the_same_method_gives_the_same_bits(home: Home, tmp_path: Path) -> None:
    loop = recorded(tmp_path / "bag")
    assert any("too far; continued with plain" in step.status.reason for step in loop.steps)
    assert not loop.steps[20].status.reason.count("plain")
    head = RecordingSource(tmp_path / "bag").head
    assert list(head.setup["methods"]) == [NAME]
    assert len(head.setup["methods"][NAME]) == 16
    found, _ = texts(tmp_path / "bag")
    assert found.identical
    assert found.steps == len(loop.steps)
    assert found.environment_differences == ()


def test_another_source_is_named(home: Home, tmp_path: Path) -> None:
    recorded(tmp_path / "bag")
    home.write(-30.0)
    found, text = texts(tmp_path / "bag")
    assert not found.identical
    assert f"method '{NAME}': recorded source " in text
    (line,) = found.method_differences
    assert line in as_plain(found)["environment_differences"]


def test_an_absent_method_is_named_and_plain_is_used(home: Home, tmp_path: Path) -> None:
    recorded(tmp_path / "bag")
    home.write(None)
    found, text = texts(tmp_path / "bag")
    assert not found.identical
    assert "absent here; plain is used" in text
    steps = simulate(RecordingSource(tmp_path / "bag"), {}).steps
    assert "absent here: method" in steps[-1].status.reason
    assert load_run(tmp_path / "bag").settings["method"] == NAME, "a report needs no method"
    with pytest.raises(SettingsError, match="cannot be imported"):
        simulate(
            RecordingSource(tmp_path / "bag"), {"method": "another_module:f", "extra_methods": ("another_module:f",)}
        )


def test_an_own_method_can_be_compared_with_others(home: Home, tmp_path: Path) -> None:
    recorded(tmp_path / "bag", "plain")
    settings = RecordingSource(tmp_path / "bag").initial_settings
    (variant,) = make_variants(settings, [NAME], {})
    assert variant.changes == {"method": NAME}
    steps = simulate(RecordingSource(tmp_path / "bag"), variant.changes).steps
    assert any("too far" in step.status.reason for step in steps)
    with pytest.raises(InputError, match=r"unknown method 'plian'; valid: all, plain, .*package.module:name"):
        make_variants(settings, ["plian"], {})


def test_a_method_that_was_too_slow_is_replaced_at_the_same_control_step(home: Home, tmp_path: Path) -> None:
    loop = recorded_loop(tmp_path / "bag", {"method": NAME, "rate_hz": 200.0})
    loop.run(0.2)
    controller = loop.controller
    assert isinstance(controller, RecordedCaller)
    controller.call(CallKind.ON_METHOD_FAULT, loop.now, "method 'x': 3 ms per call")
    loop.run(0.2)
    finish(loop)
    reasons = ["3 ms per call; continued with plain" in step.status.reason for step in loop.steps]
    assert reasons == sorted(reasons)
    assert 30 <= sum(reasons) <= 42
    found, _ = texts(tmp_path / "bag")
    assert found.identical
    assert found.steps == len(loop.steps)

"""Settings: no value out of range can exist, whoever sets it, and every parameter tells what it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.errors import SettingsError
from ik_node.settings.groups import Settings, describe
from ik_node.settings.parameter_file import read_settings


@pytest.mark.parametrize("about", describe(), ids=lambda about: about.name)
def test_each_parameter_refuses_what_is_out_of_range_or_of_another_type(about: object) -> None:
    name, default = about.name, about.default  # type: ignore[attr-defined]
    low, high, choices = about.minimum, about.maximum, about.choices  # type: ignore[attr-defined]
    assert about.description.endswith("."), "a sentence"  # type: ignore[attr-defined]
    bad: list[object] = [None, object(), (object(),)]
    bad += [] if isinstance(default, str) else ["text"]
    bad += [] if isinstance(default, bool) else [True]
    wrap = (lambda x: (x,)) if isinstance(default, tuple) else (lambda x: x)
    if low is not None:
        bad += [wrap(low - 1e-3 - abs(low)), wrap(float("nan")), wrap(float("inf"))]
    if high is not None:
        bad += [wrap(high * 2 + 1)]
    bad += ["none of them"] if choices else []
    for value in bad:
        with pytest.raises(SettingsError, match=name.split(".")[-1]):
            Settings().with_values({name: value})


def test_a_change_is_a_copy_and_flat_is_its_inverse() -> None:
    before = Settings()
    changed = before.with_values({"gain_linear": 3, "target.timeout_s": 1.5, "joints": ["a", "b"]})
    assert before == Settings()
    assert changed.control.gain_linear == 3.0
    assert changed.arm.joints == ("a", "b")
    assert Settings().with_values(changed.flat()) == changed


def test_an_unknown_name_is_refused_with_the_list() -> None:
    with pytest.raises(SettingsError, match=r"unknown parameter 'gain'; valid: .*gain_linear"):
        Settings().with_values({"gain": 1.0})


def test_a_parameter_file_is_read_as_ros_reads_it(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**:\n  ik_node:\n    ros__parameters:\n      gain_linear: 4.0\n      target: {timeout_s: 2.0}\n      x: 1\n"
    )
    assert read_settings(file) == Settings().with_values({"gain_linear": 4.0, "target.timeout_s": 2.0})
    for text in ("", "a: 1", "/**: {ik_node: {ros__parameters: 3}}", "{"):
        file.write_text(text)
        with pytest.raises(SettingsError, match="no parameter file"):
            read_settings(file)

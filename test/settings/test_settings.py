"""Settings: no value out of range is accepted from any source, and every parameter has a description."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.errors import SettingsError
from ik_node.settings.groups import Settings, describe
from ik_node.settings.parameter_file import read_settings
from ik_node.settings.replaced import REMOVED, RENAMED
from ik_node.settings.schema import limits_per_element


@pytest.mark.parametrize("about", describe(), ids=lambda about: about.name)
def test_each_parameter_refuses_what_is_out_of_range_or_of_another_type(about: object) -> None:
    name, default = about.name, about.default  # type: ignore[attr-defined]
    choices = about.choices  # type: ignore[attr-defined]
    assert about.description.endswith("."), "the description is a sentence"  # type: ignore[attr-defined]
    bad: list[object] = [None, object(), (object(),)]
    bad += [] if isinstance(default, str) else ["text"]
    bad += [] if isinstance(default, bool) else [True]
    lows, highs = limits_per_element(about)  # type: ignore[arg-type]
    for index, (low, high) in enumerate(zip(lows, highs, strict=True)):

        def wrap(number: float, index: int = index) -> object:
            if about.size:  # type: ignore[attr-defined]
                return (*default[:index], number, *default[index + 1 :])
            return (number,) if isinstance(default, tuple) else number

        bad += [] if low is None else [wrap(low - 1e-3 - abs(low)), wrap(float("nan")), wrap(float("inf"))]
        bad += [] if high is None else [wrap(high * 2 + 1)]
    bad += [(*default, default[0])] if about.size else []  # type: ignore[attr-defined]
    bad += ["none of them"] if choices else []
    for value in bad:
        with pytest.raises(SettingsError, match=name.split(".")[-1]):
            Settings().with_values({name: value})


def test_a_change_is_a_copy_and_flat_is_its_inverse() -> None:
    before = Settings()
    changed = before.with_values({"gain": [3, 4.0], "target.timeout_s": 1.5, "joints": ["a", "b"]})
    assert before == Settings()
    assert changed.control.gain == (3.0, 4.0)
    assert changed.arm.joints == ("a", "b")
    assert Settings().with_values(changed.flat()) == changed


def test_an_unknown_name_is_refused_with_the_list() -> None:
    with pytest.raises(SettingsError, match=r"unknown parameter 'gains'; valid: .*gain"):
        Settings().with_values({"gains": 1.0})


@pytest.mark.parametrize("name", [*RENAMED, *REMOVED])
def test_a_parameter_of_an_earlier_version_is_refused_with_its_replacement(name: str, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=f"'{name}' was (replaced by|removed: )"):
        Settings().with_values({name: 1.0})
    new = RENAMED.get(name, "").split(" = ")[0]
    assert not new or new in Settings().flat()
    file = tmp_path / "p.yaml"
    file.write_text(f"/**:\n  ik_node:\n    ros__parameters:\n      {name}: 1.0\n")
    with pytest.raises(SettingsError, match=f"'{name}' was (replaced by|removed: )"):
        read_settings(file)


def test_there_are_at_most_60_parameters() -> None:
    assert len(describe()) <= 60


def test_lists_of_texts_are_accepted() -> None:
    values = {
        name: ["a:b"] for name in ("obstacles.ignored_pairs", "obstacles.watched_pairs", "obstacles.package_path")
    }
    assert Settings().with_values(values).obstacles.ignored_pairs == ("a:b",)


def test_a_parameter_file_is_read_as_ros_reads_it(tmp_path: Path) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(
        "/**:\n  ik_node:\n    ros__parameters:\n      gain: [4.0, 10.0]\n      target: {timeout_s: 2.0}\n      x: 1\n"
    )
    assert read_settings(file) == Settings().with_values({"gain": (4.0, 10.0), "target.timeout_s": 2.0})
    for text in ("", "a: 1", "/**: {ik_node: {ros__parameters: 3}}", "{"):
        file.write_text(text)
        with pytest.raises(SettingsError, match="no parameter file"):
            read_settings(file)

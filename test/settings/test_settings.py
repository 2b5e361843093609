"""Settings: no value out of range is accepted from any source, and every parameter has a description."""

from __future__ import annotations

from pathlib import Path

import pytest

from ik_node.errors import SettingsError
from ik_node.settings.groups import Settings, describe
from ik_node.settings.parameter_file import read_settings
from ik_node.settings.replaced import REMOVED, RENAMED
from ik_node.settings.schema import limits_per_element
from ik_node.settings.yaml_text import with_uniform_numbers


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

        bad += [] if low is None else [wrap(low - 1e-3 - abs(low)), wrap(float("nan")), wrap(float("-inf"))]
        if high != float("inf"):  # a parameter whose upper end is infinite may be infinite
            bad += [] if low is None else [wrap(float("inf"))]
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


@pytest.mark.parametrize(
    ("name", "nearest"),
    [
        ("gains", "nearest: gain$"),
        ("gain_liner", "nearest: gain$"),
        ("limit.velocity", "nearest: limits.velocity$"),
        ("xyzzy", "valid: arm_delay_s, .*"),
    ],
)
def test_an_unknown_name_is_refused_with_the_nearest(name: str, nearest: str) -> None:
    with pytest.raises(SettingsError, match=f"unknown parameter '{name}'; {nearest}"):
        Settings().with_values({name: 1.0})


def test_a_name_without_its_group_is_found() -> None:
    with pytest.raises(SettingsError, match=r"nearest: jog.timeout_s, singularity.timeout_s, .*target.timeout_s$"):
        Settings().with_values({"timeout_s": 1.0})


def test_the_message_has_the_full_name_the_type_and_what_is_valid() -> None:
    for name, value, text in (
        ("jog.timeout_s", "long", r"^jog.timeout_s is 'long' \(string\); valid: a double, 0.01 to 10 s$"),
        ("gain", ["a", 1], r"^gain is \['a', 1.0\] \(list of string and double\); valid: a list of 2 doubles$"),
        ("gain", [1], "^gain has 1 elements; valid: a list of 2 doubles"),
        ("limits.velocity", 1.0, r"^limits.velocity is 1.0 \(double\); valid: a list of doubles$"),
        ("joints", [1], r"^joints is \[1\] \(list of integer\); valid: a list of strings$"),
        ("follow.enabled", 1, r"^follow.enabled is 1 \(integer\); valid: true, false$"),
        ("gain", [10**400, 1], "^gain is .*; valid: finite numbers$"),
        ("robot", "x" * 10_000, None),
        ("method", "x" * 10_000, "^method is .{83}; valid: plain, "),
    ):
        if text is None:
            Settings().with_values({name: value})
            continue
        with pytest.raises(SettingsError, match=text):
            Settings().with_values({name: value})


def test_whole_numbers_are_taken_for_doubles() -> None:
    changed = Settings().with_values({"gain": [1, 2.5], "target.timeout_s": 1, "limits.velocity": (1, 2)})
    assert changed == Settings().with_values(
        {"gain": [1.0, 2.5], "target.timeout_s": 1.0, "limits.velocity": [1.0, 2.0]}
    )
    assert all(type(number) is float for number in (*changed.control.gain, *changed.limits.velocity))
    assert type(changed.target.timeout_s) is float


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


def test_there_are_at_most_65_parameters() -> None:
    assert len(describe()) <= 65


def test_lists_of_texts_are_accepted() -> None:
    values = {
        name: ["a:b"] for name in ("obstacles.ignored_pairs", "obstacles.watched_pairs", "obstacles.package_path")
    }
    assert Settings().with_values(values).obstacles.ignored_pairs == ("a:b",)


def parameter_file(folder: Path, text: str, section: str = "/**:\n  ik_node:\n    ros__parameters: ") -> Path:
    file = folder / "p.yaml"
    file.write_text(section + text)
    return file


def test_a_parameter_file_is_read_as_ros_reads_it(tmp_path: Path) -> None:
    want = Settings().with_values({"gain": (4.0, 10.0), "target.timeout_s": 2.0})
    text = "{gain: [4, 1e1], target: {timeout_s: 2}, use_sim_time: true, autostart: false, qos_overrides: {x: {y: 1}}}"
    for section in ("/**:\n  ik_node:\n", "/**:\n", "ik_node:\n", "/ik_node:\n", "/*:\n", "/**/ik_node:\n"):
        assert read_settings(parameter_file(tmp_path, text, f"{section}    ros__parameters: ")) == want
    for text in ("", "a: 1", "/**: {ik_node: {ros__parameters: 3}}", "{", "[" * 5000, "a: &a [1]\nb: *a"):
        with pytest.raises(SettingsError, match="is no parameter file"):
            read_settings(parameter_file(tmp_path, text, ""))
    (tmp_path / "p.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="is no parameter file"):
        read_settings(tmp_path / "p.yaml")
    with pytest.raises(SettingsError, match="has 1000050 bytes; a parameter file has at most 1000000"):
        read_settings(parameter_file(tmp_path, "#" * 1_000_050, ""))


def test_a_parameter_file_with_an_unknown_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"p.yaml': unknown parameter 'gian'; nearest: gain$"):
        read_settings(parameter_file(tmp_path, "{gian: [1.0, 1.0]}"))


def test_a_parameter_file_for_another_node_is_refused_in_one_line(tmp_path: Path) -> None:
    text = r"p.yaml' has no parameters for node /left_arm; it has some for /\*\*/ik_node$"
    with pytest.raises(SettingsError, match=text):
        read_settings(parameter_file(tmp_path, "{gain: [1.0, 1.0]}"), "left_arm")


@pytest.mark.parametrize(
    ("text", "uniform"),
    [
        ("[1, 2.5]", "[1.0, 2.5]"),
        ("a: [1, -2, .5, 1e3]  # 1, 2", "a: [1.0, -2.0, .5, 1e3]  # 1, 2"),
        ("a:\n- 1\n- 2.5\n", "a:\n- 1.0\n- 2.5\n"),
        ("[1, 2]", "[1, 2]"),
        ("[1, a]", "[1, a]"),
        ("['1', 2.5]", "['1', 2.5]"),
        ("[1, .inf]", "[1.0, .inf]"),
        ("{", "{"),
        ("", ""),
    ],
)
def test_lists_of_mixed_numbers_become_doubles(text: str, uniform: str) -> None:
    assert with_uniform_numbers(text) == uniform

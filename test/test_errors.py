"""Every error of the package is one printable line of bounded length, whatever it names."""

from __future__ import annotations

import pytest

from ik_node.errors import LONGEST_MESSAGE, IkNodeError, MissingPackageError, SettingsError, UnknownNameError
from ik_node.settings.groups import Settings


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\nb\tc", "a b c"),
        ("\x1b[31mred\x07", r"\x1b[31mred\x07"),
        ("\ud800", r"\ud800"),
        ("überprüfen: 5 µm", "überprüfen: 5 µm"),
        ("x" * 9_000 + "end", "x" * (LONGEST_MESSAGE // 2 - 2) + "..." + "x" * (LONGEST_MESSAGE // 2 - 5) + "end"),
    ],
)
def test_messages_are_one_line(text: str, shown: str) -> None:
    assert str(IkNodeError(text)) == shown
    assert str(UnknownNameError("frame", text, ())).startswith(f"unknown frame '{shown[:30]}")


def test_names_of_a_file_are_printable_in_its_error() -> None:
    with pytest.raises(SettingsError) as caught:
        Settings().with_values({"ga\nin\x1b": 1.0})
    assert str(caught.value).isprintable()
    str(caught.value).encode()


def test_a_missing_package_keeps_its_message() -> None:
    assert "pip install" in str(MissingPackageError(ImportError("no", name="viser")))

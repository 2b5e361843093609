"""Snapshots of other versions: a field that a version did not have is left at its default."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import pytest

from ik_node.errors import InputError
from ik_node.recording.json_codec import from_json, to_json


class Earlier(NamedTuple):
    """A record of an earlier version."""

    number: int


class Present(NamedTuple):
    """The same record with another field."""

    number: int
    added: tuple[int, int] = (1, 2)


@dataclasses.dataclass
class Holder:
    """A dataclass with the record."""

    record: Present
    text: str = "none"


def test_a_missing_field_has_its_default() -> None:
    assert from_json(to_json(Earlier(3)), Present) == Present(3)
    assert from_json(to_json({"record": Earlier(4)}), Holder) == Holder(Present(4))


def test_a_missing_field_without_default_is_an_error() -> None:
    with pytest.raises(InputError, match="no Present"):
        from_json("{}", Present)

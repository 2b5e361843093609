"""What an object remembers from call to call, as plain data: to be recorded, and to go on from elsewhere.

A part with a memory states it as a NamedTuple or dataclass of plain values. Its fields are the attributes of the part,
with or without a leading underscore; copies go in and out, so that neither side sees the other's changes.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, TypeVar

Memory = TypeVar("Memory")


def remembered(part: object, kind: type[Memory]) -> Memory:
    """The memory ``kind`` of ``part``."""
    attributes = vars(part)
    return kind(**{name: deepcopy(attributes[_attribute(attributes, name)]) for name in kind.__annotations__})


def recall(part: object, memory: Any) -> None:
    """Puts ``memory`` into ``part``, which goes on from there."""
    attributes = vars(part)
    for name in type(memory).__annotations__:
        attributes[_attribute(attributes, name)] = deepcopy(getattr(memory, name))


def _attribute(attributes: dict[str, Any], name: str) -> str:
    return name if name in attributes else f"_{name}"

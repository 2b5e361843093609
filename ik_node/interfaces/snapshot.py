"""Snapshots: the internal state of an object as plain data, for recordings and for restoring it elsewhere.

An object with internal state defines a ``...Snapshot``, a NamedTuple or dataclass of plain values, whose fields are
attributes of the object, with or without a leading underscore. Values are copied in both directions, so a snapshot and
the object never share mutable data.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Any, TypeVar

Snapshot = TypeVar("Snapshot")


def capture(part: object, kind: type[Snapshot]) -> Snapshot:
    """Copies the attributes of an object into a snapshot.

    Args:
        part: The object.
        kind: Type of the snapshot; each of its fields names an attribute of ``part``.

    Returns:
        The snapshot, which shares no mutable data with ``part``.
    """
    attributes = vars(part)
    return kind(**{name: deepcopy(attributes[_attribute(attributes, name)]) for name in kind.__annotations__})


def restore(part: object, snapshot: Any) -> None:
    """Sets the attributes of an object to those of a snapshot.

    Args:
        part: An object of the same class as the one that was captured.
        snapshot: Result of :func:`capture`.
    """
    attributes = vars(part)
    for name in type(snapshot).__annotations__:
        attributes[_attribute(attributes, name)] = deepcopy(getattr(snapshot, name))


def _attribute(attributes: dict[str, Any], name: str) -> str:
    return name if name in attributes else f"_{name}"

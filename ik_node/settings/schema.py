"""How a parameter is declared, described and checked.

A parameter is a field of a frozen dataclass derived from :class:`Group`; :func:`setting` attaches unit, range, choices
and a description to it. A group checks its fields when it is built, so that no group with an invalid value exists.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ik_node.errors import SettingsError

Value = bool | int | float | str | tuple[str, ...] | tuple[float, ...]
Limit = float | tuple[float, ...] | None
"""An end of a range: one number, one number per element of a list, or None where the range is open."""


def setting(
    default: Value,
    description: str,
    unit: str = "",
    minimum: Limit = None,
    maximum: Limit = None,
    choices: tuple[str, ...] = (),
    read_only: bool = False,
    element: type = float,
    size: int = 0,
) -> Any:
    """Declares a parameter as a dataclass field.

    Args:
        default: Default value; its type is the parameter's type.
        description: One sentence for the user.
        unit: Unit of the value, or of each element, separated by commas.
        minimum: Smallest valid number.
        maximum: Largest valid number.
        choices: Valid texts; empty for any text.
        read_only: True if the parameter cannot change while the node runs.
        element: Type of the elements of a list.
        size: Required length of a list; 0 for any length.

    Returns:
        The dataclass field.
    """
    about = {
        "description": description,
        "unit": unit,
        "minimum": minimum,
        "maximum": maximum,
        "choices": choices,
        "read_only": read_only,
        "element": element,
        "size": size,
    }
    return field(default=default, metadata=about)


class Descriptor(NamedTuple):
    """Name, default value and metadata of one parameter; the other fields are the arguments of :func:`setting`."""

    name: str
    default: Value
    description: str
    unit: str
    minimum: Limit
    maximum: Limit
    choices: tuple[str, ...]
    read_only: bool
    element: type
    size: int

    @property
    def default_text(self) -> str:
        """The default value as text; empty for an empty text or list."""
        if isinstance(self.default, tuple):
            return ", ".join(str(entry) if isinstance(entry, str) else f"{entry:g}" for entry in self.default)
        if isinstance(self.default, bool):
            return str(self.default).lower()
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)

    @property
    def valid_text(self) -> str:
        """The choices or the range as text; empty if every value is valid."""
        if self.choices:
            return ", ".join(self.choices)
        ranges = (_range_text(low, high) for low, high in zip(*limits_per_element(self), strict=True))
        return ", ".join(text for text in dict.fromkeys(ranges) if text)


def limits_per_element(about: Descriptor) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """The lower and the upper limits of each element; one element for a scalar or a list of any length."""
    count = max(about.size, 1)
    low, high = (limit if isinstance(limit, tuple) else (limit,) * count for limit in (about.minimum, about.maximum))
    return low, high


def _range_text(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return ""
    return f"{'-∞' if low is None else f'{low:g}'} … {'∞' if high is None else f'{high:g}'}"


@dataclass(frozen=True)
class Group:
    """Base of the groups of parameters; raises SettingsError when it is built with an invalid value."""

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            if entry.metadata:
                _check(entry.name, getattr(self, entry.name), entry.default, entry.metadata)


def _check(name: str, value: Any, default: Any, about: Mapping[str, Any]) -> None:
    _check_type(name, value, default, about)
    if about["choices"] and value not in about["choices"]:
        raise SettingsError(f"{name} is {value!r}; valid: {', '.join(about['choices'])}")
    numbers = value if isinstance(value, tuple) else (value,)
    for index, number in enumerate(numbers):
        if isinstance(number, (str, bool)):
            continue
        if not math.isfinite(number):
            raise SettingsError(f"{name} is {value!r}; expected finite numbers")
        low, high = (_of_element(about[end], index) for end in ("minimum", "maximum"))
        if (low is not None and number < low) or (high is not None and number > high):
            where = f"[{index}]" if about["size"] else ""
            raise SettingsError(f"{name}{where} is {number!r}; valid: {_range(low, high)} {about['unit']}".rstrip())


def _check_type(name: str, value: Any, default: Any, about: Mapping[str, Any]) -> None:
    expected = type(default)
    if expected is tuple:
        kinds = (about["element"], int) if about["element"] is float else (about["element"],)
        kind, size = about["element"].__name__, about["size"]
        if not isinstance(value, tuple) or any(type(entry) not in kinds for entry in value):
            raise SettingsError(f"{name} is {value!r}; expected a list of {f'{size} {kind}s' if size else kind}")
        if size and len(value) != size:
            raise SettingsError(f"{name} has {len(value)} elements; expected {size}: {about['description']}")
    elif expected is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise SettingsError(f"{name} is {value!r}; expected a number")
    elif not isinstance(value, expected) or (expected is not bool and isinstance(value, bool)):
        raise SettingsError(f"{name} is {value!r}; expected a {expected.__name__}")


def _of_element(limit: Limit, index: int) -> float | None:
    return limit[index] if isinstance(limit, tuple) else limit


def _range(low: float | None, high: float | None) -> str:
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}"

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
    further: str = "",
) -> Any:
    """Declares a parameter as a dataclass field.

    Args:
        default: Default value; its type is the parameter's type.
        description: One sentence for the user.
        unit: Unit of the value, or of each element, separated by commas.
        minimum: Smallest valid number.
        maximum: Largest valid number; ``math.inf`` also permits infinite numbers.
        choices: Valid texts; empty for any text.
        read_only: True if the parameter cannot change while the node runs.
        element: Type of the elements of a list.
        size: Required length of a list; 0 for any length.
        further: Names what is valid besides ``choices``; the group checks it. Empty: nothing else is valid.

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
        "further": further,
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
    further: str = ""

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
            return ", ".join((*self.choices, self.further) if self.further else self.choices)
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
        prefix = getattr(self, "prefix", "")
        for entry in dataclasses.fields(self):
            if entry.metadata:
                name = f"{prefix}.{entry.name}" if prefix else entry.name
                default: Any = entry.default
                check(name, getattr(self, entry.name), Descriptor(name=name, default=default, **entry.metadata))


def converted(value: Any, about: Descriptor) -> Any:
    """A value as the type of the parameter, where that loses nothing; any other value unchanged.

    Args:
        value: A value from a file, a command line or ROS.
        about: Description of the parameter.

    Returns:
        Whole numbers as floats where the parameter is a double or a list of doubles, lists as tuples.
    """
    if isinstance(about.default, tuple) and isinstance(value, (list, tuple)):
        return tuple(_as_double(entry) for entry in value) if about.element is float else tuple(value)
    return _as_double(value) if isinstance(about.default, float) else value


def _as_double(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int):
        return value
    try:
        return float(value)
    except OverflowError:  # a whole number beyond the doubles; refused as not finite
        return math.inf


def check(name: str, value: Any, about: Descriptor) -> None:
    """Checks the type, the length, the range and the choices of a value.

    Args:
        name: Name of the parameter in the message.
        value: The value.
        about: Description of the parameter.

    Raises:
        SettingsError: The value is invalid; one line with the name, the value, its type and what is valid.
    """
    if not _has_type(value, about):
        raise SettingsError(f"{name} is {shown(value)} ({_type_name(value)}); valid: {_expected(about)}")
    if about.size and len(value) != about.size:
        raise SettingsError(f"{name} has {len(value)} elements; valid: {_expected(about)}: {about.description}")
    if about.choices and not about.further and value not in about.choices:
        raise SettingsError(f"{name} is {shown(value)}; valid: {', '.join(about.choices)}")
    for index, number in enumerate(value if isinstance(value, tuple) else (value,)):
        if isinstance(number, (str, bool)):
            continue
        low, high = (_of_element(end, index) for end in (about.minimum, about.maximum))
        if math.isnan(number) or (math.isinf(number) and high != math.inf):
            valid = "numbers" if high == math.inf else "finite numbers"
            raise SettingsError(f"{name} is {shown(value)}; valid: {valid}")
        if (low is not None and number < low) or (high is not None and number > high):
            where = f"[{index}]" if about.size else ""
            raise SettingsError(f"{name}{where} is {number!r}; valid: {_range(low, high)} {about.unit}".rstrip())


def _has_type(value: Any, about: Descriptor) -> bool:
    if isinstance(about.default, tuple):
        kinds = (float, int) if about.element is float else (about.element,)
        return isinstance(value, tuple) and all(type(entry) in kinds for entry in value)
    if isinstance(about.default, float):
        return isinstance(value, (int, float)) and not isinstance(value, bool)
    return isinstance(value, type(about.default)) and isinstance(value, bool) == isinstance(about.default, bool)


TYPE_NAMES: Mapping[type, str] = {bool: "bool", int: "integer", float: "double", str: "string"}
"""Names of the types in ROS parameter files."""
MAX_SHOWN = 80
"""Longest text of a value in a message, so that the message stays one readable line."""


def shown(value: Any) -> str:
    """A value in a message, cut at :data:`MAX_SHOWN` characters."""
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def _type_name(value: Any) -> str:
    if isinstance(value, (tuple, list)):
        names = dict.fromkeys(_type_name(entry) for entry in value)
        return f"list of {' and '.join(names) or 'nothing'}"
    return TYPE_NAMES.get(type(value), type(value).__name__)


def _expected(about: Descriptor) -> str:
    if about.choices:
        return ", ".join(about.choices)
    if isinstance(about.default, bool):
        return "true, false"
    if isinstance(about.default, tuple):
        count = f"{about.size} " if about.size else ""
        return f"a list of {count}{TYPE_NAMES[about.element]}s"
    kind = TYPE_NAMES[type(about.default)]
    if about.minimum is None and about.maximum is None:
        return f"a {kind}"
    return f"a {kind}, {_range(_of_element(about.minimum, 0), _of_element(about.maximum, 0))} {about.unit}".rstrip()


def _of_element(limit: Limit, index: int) -> float | None:
    return limit[index] if isinstance(limit, tuple) else limit


def _range(low: float | None, high: float | None) -> str:
    return f"{'-inf' if low is None else f'{low:g}'} to {'inf' if high is None else f'{high:g}'}"

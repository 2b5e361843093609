"""Plain data <-> JSON with the same types and bits after decoding.

Plain data: numbers, text, None, enums, NumPy arrays, tuples, mappings with text keys, and NamedTuples and dataclasses
of these. The decoder is given the type, so the JSON contains values only. Floats are written with the shortest unique
representation; non-finite ones are the texts "nan", "inf" and "-inf". A large array is stored as its shape and the
hexadecimal digits of its little-endian bytes, which is a hundred times faster.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
from collections.abc import Mapping
from enum import Enum
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError

LARGEST_READABLE = 64
"""Largest array, in entries, that is stored as a list of numbers."""

_ARRAY_ALIAS = get_origin(NDArray[np.float64])
"""A separate type since NumPy 2.5 with Python 3.12; before, np.ndarray."""


def to_json(value: object) -> str:
    """Encodes plain data; raises InputError naming a type that is not plain data."""
    return json.dumps(_plain(value), allow_nan=False, separators=(",", ":"))


def from_json(text: str, kind: Any) -> Any:
    """Decodes a value.

    Args:
        text: Result of :func:`to_json`.
        kind: Type of the value.

    Raises:
        InputError: The text does not contain a value of this type.
    """
    try:
        return _typed(json.loads(text), kind)
    # AttributeError: a value without entries; OverflowError: a whole number beyond the floats.
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise InputError(f"text is no {getattr(kind, '__name__', kind)}: {error}") from error


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        value = value.value
    elif isinstance(value, np.ndarray) and value.size > LARGEST_READABLE:
        little = value.dtype.newbyteorder("<")
        return {"shape": list(value.shape), "hex": value.astype(little).tobytes().hex()}
    elif isinstance(value, (np.ndarray, np.generic)):
        finite = bool(np.isfinite(value).all())
        value = value.tolist()
        if finite:
            return value
    elif dataclasses.is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in dataclasses.fields(value)}
    elif isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    raise InputError(f"{type(value).__name__} is not plain data")


def _typed(value: Any, kind: Any) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        return _one_of(value, arguments)
    if origin in (np.ndarray, _ARRAY_ALIAS):
        return _array(value, np.dtype(get_args(arguments[1])[0] if origin is np.ndarray else arguments[0]))
    if origin is tuple:
        if not isinstance(value, list):
            raise ValueError(f"{value!r} is no list")
        kinds = [arguments[0]] * len(value) if arguments[1:] == (...,) else arguments
        return tuple(_typed(entry, entry_kind) for entry, entry_kind in zip(value, kinds, strict=True))
    if origin is not None and issubclass(origin, Mapping):
        return {key: _typed(entry, arguments[1]) for key, entry in value.items()}
    if dataclasses.is_dataclass(kind) or hasattr(kind, "_fields"):
        # A field that an earlier version did not have is left at its default; without one, the call raises TypeError.
        return kind(**{name: _typed(value[name], entry) for name, entry in _fields(kind).items() if name in value})
    if kind in (bool, int, str) and type(value) is not kind:
        raise ValueError(f"{value!r} is no {kind.__name__}")
    return kind(value)


def _one_of(value: Any, kinds: tuple[Any, ...]) -> Any:
    """A value of the first type in ``kinds`` that matches."""
    if value is None:
        return None
    for kind in kinds:
        try:
            return _typed(value, kind)
        except (ValueError, LookupError, TypeError, AttributeError, OverflowError):
            continue
    raise ValueError(f"{value!r} fits none of {kinds}")


def _array(value: Any, dtype: np.dtype[Any]) -> Any:
    if isinstance(value, dict):
        raw = np.frombuffer(bytes.fromhex(value["hex"]), dtype.newbyteorder("<"))
        return raw.astype(dtype).reshape(value["shape"])
    return np.array(_numbers(value), dtype=dtype)


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return [_numbers(entry) for entry in value]
    return float(value) if isinstance(value, str) else value


@cache
def _fields(kind: Any) -> Mapping[str, Any]:
    hints = get_type_hints(kind)
    names = kind._fields if hasattr(kind, "_fields") else [entry.name for entry in dataclasses.fields(kind)]
    return {name: hints[name] for name in names}

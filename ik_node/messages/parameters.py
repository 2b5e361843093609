"""Parameter values <-> rcl_interfaces/ParameterEvent, the standard message for parameter changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import InputError, RecordingError
from ik_node.messages.cdr import deserialize, make, serialize, time_message
from ik_node.settings.schema import Value

PARAMETERS_TYPE = "rcl_interfaces/msg/ParameterEvent"
_BOOL, _INTEGER, _DOUBLE, _STRING, _DOUBLES, _STRINGS = 1, 2, 3, 4, 8, 9
_FIELDS = {
    _BOOL: "bool_value",
    _INTEGER: "integer_value",
    _DOUBLE: "double_value",
    _STRING: "string_value",
    _DOUBLES: "double_array_value",
    _STRINGS: "string_array_value",
}
_UNSET: dict[str, Any] = {
    "bool_value": False,
    "integer_value": 0,
    "double_value": 0.0,
    "string_value": "",
    "byte_array_value": np.empty(0, np.uint8),
    "bool_array_value": np.empty(0, np.bool_),
    "integer_array_value": np.empty(0, np.int64),
    "double_array_value": np.empty(0),
    "string_array_value": [],
}


class Parameters(NamedTuple):
    """Content of a parameter message."""

    values: dict[str, Value]
    """All parameters after the change."""
    changed: dict[str, Value]
    """The changed parameters; empty in the first message."""


def encode_parameters(node: str, stamp_ns: int, parameters: Parameters) -> bytes:
    """Encodes all values as ``new_parameters`` and the changed ones as ``changed_parameters``.

    Args:
        node: Full name of the node.
        stamp_ns: ROS time of the change.
        parameters: The values.

    Raises:
        InputError: A value has a type that cannot be recorded.
    """
    message = make(
        PARAMETERS_TYPE,
        stamp=time_message(stamp_ns),
        node=node,
        new_parameters=_parameters(parameters.values),
        changed_parameters=_parameters(parameters.changed),
        deleted_parameters=[],
    )
    return serialize(message)


def decode_parameters(data: bytes) -> Parameters:
    """Decodes parameters.

    Args:
        data: CDR bytes of a rcl_interfaces/ParameterEvent.

    Raises:
        InputError: The bytes are no such message.
        RecordingError: A parameter has a type that is never recorded.
    """
    message = deserialize(data, PARAMETERS_TYPE)
    return Parameters(_values(message.new_parameters), _values(message.changed_parameters))


def _parameters(values: Mapping[str, Value]) -> list[object]:
    return [make("rcl_interfaces/msg/Parameter", name=name, value=_encoded(value)) for name, value in values.items()]


def _encoded(value: Value) -> object:
    kind = _kind(value)
    plain = np.array(value, dtype=np.float64) if kind == _DOUBLES else list(value) if kind == _STRINGS else value  # type: ignore[arg-type]
    fields = {**_UNSET, _FIELDS[kind]: plain}
    return make("rcl_interfaces/msg/ParameterValue", type=kind, **fields)


def _kind(value: Value) -> int:
    if isinstance(value, bool):
        return _BOOL
    if isinstance(value, int):
        return _INTEGER
    if isinstance(value, float):
        return _DOUBLE
    if isinstance(value, str):
        return _STRING
    if not isinstance(value, tuple):
        raise InputError(f"parameter value {value!r} has a type that cannot be recorded")
    return _STRINGS if all(isinstance(entry, str) for entry in value) else _DOUBLES


def _values(parameters: Any) -> dict[str, Value]:
    return {str(parameter.name): _decoded(parameter) for parameter in parameters}


def _decoded(parameter: Any) -> Value:
    kind = int(parameter.value.type)
    if kind not in _FIELDS:
        raise RecordingError(f"parameter '{parameter.name}' has type {kind}; valid: {', '.join(map(str, _FIELDS))}")
    value = getattr(parameter.value, _FIELDS[kind])
    if kind == _STRINGS:
        return tuple(str(entry) for entry in value)
    if kind == _DOUBLES:
        return tuple(float(entry) for entry in value)
    plain: Value = {_BOOL: bool, _INTEGER: int, _DOUBLE: float, _STRING: str}[kind](value)
    return plain

"""Settings as ROS parameters: declared with description, unit and range, read, and changed at run time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterUninitializedException
from rclpy.parameter import Parameter

from ik_node.errors import IkNodeError
from ik_node.settings.groups import Descriptor, Settings, Value, describe

BIG = 1e12
"""Stands for an open end: parameter ranges have two ends."""


def declare(node: Any) -> None:
    """Declares every setting on ``node``, with what people need to know about it."""
    for about in describe():
        node.declare_parameter(about.name, _declared(about), _descriptor(about))


def read(node: Any) -> Settings:
    """The node's parameters as settings; SettingsError naming the parameter that is out of range."""
    return Settings().with_values({about.name: _read_one(node, about) for about in describe()})


def follow_changes(
    node: Any, current: Callable[[], Settings], check: Callable[[Settings], None], apply: Callable[[Settings], None]
) -> None:
    """Lets parameters change at run time: ``check`` has no side effects and refuses with one of our errors.

    ``apply`` is called once everybody has accepted.
    """
    known = {about.name: about for about in describe()}

    def changed(parameters: Sequence[Parameter]) -> Settings:
        ours = [parameter for parameter in parameters if parameter.name in known]
        return current().with_values({p.name: _value(p, known[p.name]) for p in ours})

    def on_set(parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            check(changed(parameters))
        except IkNodeError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def on_post_set(parameters: Sequence[Parameter]) -> None:
        apply(changed(parameters))

    node.add_on_set_parameters_callback(on_set)
    node.add_post_set_parameters_callback(on_post_set)


def _declared(about: Descriptor) -> Any:
    if about.default == ():
        return Parameter.Type.STRING_ARRAY if about.element is str else Parameter.Type.DOUBLE_ARRAY
    return list(about.default) if isinstance(about.default, tuple) else about.default


def _read_one(node: Any, about: Descriptor) -> Value:
    try:
        return _value(node.get_parameter(about.name), about)
    except ParameterUninitializedException:  # an empty list cannot be declared with a type
        return about.default


def _value(parameter: Parameter, about: Descriptor) -> Value:
    value: Any = parameter.value
    return tuple(value) if isinstance(about.default, tuple) else value


def _descriptor(about: Descriptor) -> ParameterDescriptor:
    unit = f" [{about.unit}]" if about.unit else ""
    descriptor = ParameterDescriptor(description=about.description + unit, read_only=about.read_only)
    if about.choices:
        descriptor.additional_constraints = "one of: " + ", ".join(about.choices)
    if isinstance(about.default, float) and (about.minimum is not None or about.maximum is not None):
        low = -BIG if about.minimum is None else about.minimum
        high = BIG if about.maximum is None else about.maximum
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
    return descriptor

"""Settings as ROS parameters: declaration with description, unit and range, reading, and changes at run time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import ParameterUninitializedException
from rclpy.parameter import Parameter

from ik_node.errors import IkNodeError, SettingsError
from ik_node.settings.groups import Settings, describe
from ik_node.settings.replaced import REMOVED, RENAMED, replacement
from ik_node.settings.schema import Descriptor, Value, limits_per_element

BIG = 1e12
"""Replaces an infinite limit: ROS parameter ranges have two finite ends."""


def declare(node: Any) -> None:
    """Declare every parameter on ``node`` with description, unit and range.

    Raises:
        SettingsError: The node was started with a parameter of an earlier version; the message names its replacement.
    """
    # ROS ignores the values of undeclared parameters, so the old names are declared to find out whether they are set.
    for name in (*RENAMED, *REMOVED):
        value = node.declare_parameter(name, None, ParameterDescriptor(dynamic_typing=True)).value
        node.undeclare_parameter(name)
        if value is not None:
            raise SettingsError(replacement(name))
    for about in describe():
        node.declare_parameter(about.name, _declared(about), _descriptor(about))


def read(node: Any) -> Settings:
    """Return the parameters of ``node`` as settings; raises SettingsError naming an invalid parameter."""
    return Settings().with_values({about.name: _read_one(node, about) for about in describe()})


def follow_changes(
    node: Any, current: Callable[[], Settings], check: Callable[[Settings], None], apply: Callable[[Settings], None]
) -> None:
    """Let parameters change at run time.

    Args:
        node: The node that has declared them.
        current: Returns the settings in force.
        check: Raises an IkNodeError for settings that cannot be used; has no side effects.
        apply: Called with the new settings after all callbacks have accepted the change.
    """
    known = {about.name: about for about in describe()}

    def changed(parameters: Sequence[Parameter]) -> Settings:
        changes = [parameter for parameter in parameters if parameter.name in known]
        return current().with_values({p.name: _value(p, known[p.name]) for p in changes})

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
        descriptor.additional_constraints = "one of: " + about.valid_text
    elif isinstance(about.default, tuple):
        size = f"{about.size} elements" if about.size else ""
        descriptor.additional_constraints = ": ".join(text for text in (size, about.valid_text) if text)
    if isinstance(about.default, float) and (about.minimum is not None or about.maximum is not None):
        (low,), (high,) = limits_per_element(about)
        ends = -BIG if low is None else low, BIG if high is None else high
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(ends[0]), to_value=float(ends[1]))]
    return descriptor

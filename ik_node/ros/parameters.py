"""Settings as ROS parameters: declaration with description, unit and range, reading, and changes at run time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from ik_node.errors import IkNodeError
from ik_node.ros import start_arguments
from ik_node.settings.groups import Settings, describe
from ik_node.settings.names import NODE_NAMES, check_names, is_ros_name
from ik_node.settings.schema import Descriptor, check, converted, limits_per_element

BIG = 1e12
"""Replaces an infinite limit: ROS parameter ranges have two finite ends."""
LONGEST_SHOWN = 60
"""Characters of a value in the log."""
AUTOSTART = Descriptor(
    "autostart", True, "Configure and activate without a request.", "", None, None, (), True, bool, 0
)
_TYPES = {
    bool: Parameter.Type.BOOL,
    int: Parameter.Type.INTEGER,
    float: Parameter.Type.DOUBLE,
    str: Parameter.Type.STRING,
}
_LIST_TYPES = {float: Parameter.Type.DOUBLE_ARRAY, str: Parameter.Type.STRING_ARRAY}


def start_values(node: Any, valid: Collection[str]) -> dict[str, Any]:
    """Values that ``node`` was started with, by file or command line, without those of rclpy itself.

    rclpy has no public access that keeps an empty list: automatically_declare_parameters_from_overrides raises
    ValueError for it. An empty list has no type there; its value is None.

    Args:
        node: The node.
        valid: Names of the parameters that it has.

    Raises:
        SettingsError: A name is unknown; the message has the nearest one, or the replacement of an old name.
    """
    overrides = node._parameter_overrides.values()
    values = {entry.name: [] if entry.value is None else entry.value for entry in overrides}
    values = {name: value for name, value in values.items() if not is_ros_name(name)}
    check_names(values, valid)
    return values


def declare_all(node: Any, parameters: Sequence[Descriptor], arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Declare parameters with description, unit, range and type; warn of parameter files for other nodes only.

    Args:
        node: The node.
        parameters: All parameters that the node has, besides those of rclpy.
        arguments: Arguments without the program's name; None takes those of the process.

    Returns:
        Name -> value.

    Raises:
        SettingsError: The node was started with an unknown parameter or an invalid value.
    """
    for line in start_arguments.unused_files(arguments, node.get_fully_qualified_name()):
        node.get_logger().warning(line)
    given = start_values(node, [about.name for about in parameters])
    values = {about.name: converted(given.get(about.name, about.default), about) for about in parameters}
    for about in parameters:
        check(about.name, values[about.name], about)
    for about in parameters:
        _declare(node, about, values[about.name])
    return values


def declare(node: Any, arguments: Sequence[str] | None = None) -> bool:
    """Declare the settings and ``autostart`` on ``node``, as :func:`declare_all` does.

    Returns:
        Whether the node configures and activates itself.

    Raises:
        SettingsError: The node was started with an unknown parameter or an invalid value.
    """
    return bool(declare_all(node, (*describe(), AUTOSTART), arguments)["autostart"])


def read(node: Any) -> Settings:
    """Return the parameters of ``node`` as settings; raises SettingsError naming an invalid parameter."""
    return Settings().with_values({about.name: node.get_parameter(about.name).value for about in describe()})


def checked_changes(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Check changed parameters before rclpy does, whose message about a wrong type does not name the parameter.

    Args:
        parameters: Wanted values.

    Returns:
        The same with whole numbers as doubles where the parameter is one, and empty lists with the right type.

    Raises:
        SettingsError: A parameter is unknown, or a value has the wrong type or is out of range.
    """
    known = {about.name: about for about in describe()}
    check_names([entry.name for entry in parameters if not is_ros_name(entry.name)], [*known, *NODE_NAMES])
    return [_checked(entry, known[entry.name]) if entry.name in known else entry for entry in parameters]


def _checked(parameter: Parameter, about: Descriptor) -> Parameter:
    value: Any = parameter.value
    if isinstance(about.default, tuple) and value is not None and not isinstance(value, (bool, int, float, str)):
        value = list(value)
    kept = converted(value, about)
    check(about.name, kept, about)
    return _parameter(about, kept)


def _parameter(about: Descriptor, value: Any) -> Parameter:
    return Parameter(about.name, _type(about), list(value) if isinstance(value, tuple) else value)


def _type(about: Descriptor) -> Parameter.Type:
    return _LIST_TYPES[about.element] if isinstance(about.default, tuple) else _TYPES[type(about.default)]


def _declare(node: Any, about: Descriptor, value: Any) -> None:
    """Declare one parameter with a value.

    An empty list cannot be declared with a type, and a parameter without a value empties the whole answer to a request
    for the values of all parameters (`ros2 param dump`); so the value is set after the declaration.
    """
    descriptor = _descriptor(about)
    descriptor.read_only = False
    node.declare_parameter(about.name, _type(about), descriptor, ignore_override=True)
    (result,) = node.set_parameters([_parameter(about, value)])
    if not result.successful:
        raise IkNodeError(f"{about.name}: {result.reason}")
    node.set_descriptor(about.name, _descriptor(about))


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
    known = {about.name for about in describe()}
    before: dict[str, Any] = {}

    def changed(parameters: Sequence[Parameter]) -> Settings:
        return current().with_values({entry.name: entry.value for entry in parameters if entry.name in known})

    def on_set(parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            before.update(current().flat())
            check(changed(parameters))
        except IkNodeError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def on_post_set(parameters: Sequence[Parameter]) -> None:
        settings = changed(parameters)
        after = settings.flat()
        names = [name for name in after if after[name] != before[name]]
        if names:
            changes = (f"{name} {_shown(before[name])} -> {_shown(after[name])}" for name in names)
            node.get_logger().info(f"parameters changed: {', '.join(changes)}")
        apply(settings)

    node.add_on_set_parameters_callback(on_set)
    node.add_post_set_parameters_callback(on_post_set)


def _shown(value: Any) -> str:
    """A value in a log line, which is not longer than needed to recognise it."""
    text = str(list(value) if isinstance(value, tuple) else value) or "''"
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def _descriptor(about: Descriptor) -> ParameterDescriptor:
    unit = f" [{about.unit}]" if about.unit else ""
    descriptor = ParameterDescriptor(description=about.description + unit, read_only=about.read_only)
    descriptor.type = _type(about).value
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

"""Reads ROS parameter files without ROS."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from ik_node.errors import InputError, SettingsError
from ik_node.settings.groups import Settings
from ik_node.settings.names import NODE_NAMES, is_ros_name
from ik_node.settings.schema import Value
from ik_node.settings.yaml_text import load_yaml, read_text

PARAMETERS = "ros__parameters"
"""Key of the parameters below the name of a node."""


def read_settings(path: Path, node: str = "ik_node") -> Settings:
    """Reads the parameters of one node from a parameter file.

    Args:
        path: YAML file as ROS 2 reads it.
        node: Name of the node, with its namespace if it has one.

    Returns:
        The settings of the file, with default values elsewhere. Parameters of ROS itself are ignored.

    Raises:
        SettingsError: The file has no section for the node, a name is unknown, a value is invalid, or a parameter
            belongs to an earlier version.
    """
    return settings_of(path, read_sections(path), node)


def settings_of(path: Path, sections: dict[str, dict[str, Any]], node: str = "ik_node") -> Settings:
    """As :func:`read_settings`, of sections that were read from ``path``."""
    values = values_of(sections, node)
    if values is None:
        raise SettingsError(no_section_text(path, node, sections))
    own = {name: value for name, value in values.items() if name not in NODE_NAMES}
    try:
        return Settings().with_values(own)
    except SettingsError as error:
        raise SettingsError(f"'{path}': {error}") from error


def values_of(sections: dict[str, dict[str, Any]], node: str) -> dict[str, Any] | None:
    """Parameters of a node, without those of ROS itself; None if no section is for it."""
    used = [values for name, values in sections.items() if addresses(name, node)]
    joined = {name: value for section in used for name, value in section.items() if not is_ros_name(name)}
    return joined if used else None


def read_sections(path: Path) -> dict[str, dict[str, Any]]:
    """The sections of a parameter file.

    Args:
        path: YAML file as ROS 2 reads it.

    Returns:
        Name of a node as the file has it, such as ``/**/ik_node`` -> its parameters, flat.

    Raises:
        SettingsError: The file cannot be read, or has no parameters.
    """
    return sections_in(read_text(path), path)


def sections_in(text: str, path: Path) -> dict[str, dict[str, Any]]:
    """As :func:`read_sections`, in a text that is or will be the file ``path``."""
    found: dict[str, dict[str, Any]] = {}
    try:
        _collect(load_yaml(text), "", found)
    except (yaml.YAMLError, InputError, TypeError, ValueError, AttributeError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise SettingsError(f"'{path}' is no parameter file with /**: NODE: {PARAMETERS}: ({reason})") from error
    if not found:
        raise SettingsError(f"'{path}' is no parameter file with /**: NODE: {PARAMETERS}:")
    return found


def addresses(section: str, node: str) -> bool:
    """Whether the name of a section, with * for one and ** for any number of parts, is that of ``node``."""
    parts = (part for part in section.split("/") if part)
    pattern = "".join(
        "(/[^/]+)*" if part == "**" else "/[^/]+" if part == "*" else f"/{re.escape(part)}" for part in parts
    )
    return re.fullmatch(pattern, f"/{node.strip('/')}") is not None


def no_section_text(path: Path, node: str, sections: dict[str, dict[str, Any]]) -> str:
    """One line about a file that has parameters for other nodes only."""
    return f"'{path}' has no parameters for node /{node.strip('/')}; it has some for {', '.join(sections)}"


def parse_assignment(assignment: str) -> tuple[str, Value]:
    """Parses ``name=value`` with a YAML value.

    Raises:
        InputError: The text is no assignment.
        SettingsError: There is no such parameter, or the value is invalid.
    """
    name, equals, text = assignment.partition("=")
    try:
        value = load_yaml(text) if equals else None
    except (yaml.YAMLError, InputError, ValueError, RecursionError):
        value = None
    if value is None:
        raise InputError(f"'{assignment}' is no assignment; expected NAME=VALUE")
    return name, Settings().with_values({name: value}).flat()[name]


def _collect(tree: Any, name: str, found: dict[str, dict[str, Any]]) -> None:
    for key, below in tree.items():
        if key == PARAMETERS:
            found.setdefault(name or "/", {}).update(_flat(below))
        elif isinstance(below, dict):
            _collect(below, f"{name}/{str(key).strip('/')}", found)


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + str(name): value}
    return flat

"""Reads ROS parameter files without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ik_node.errors import SettingsError
from ik_node.settings.groups import Settings, describe
from ik_node.settings.replaced import replacement


def read_settings(path: Path, node: str = "ik_node") -> Settings:
    """Reads the section ``/**: <node>: ros__parameters:`` of a parameter file.

    Args:
        path: YAML file as ROS 2 reads it.
        node: Name of the node in the file.

    Returns:
        The settings of the file, with default values elsewhere. Parameters unknown to this package are ignored, since
        a node may have others.

    Raises:
        SettingsError: The file has no such section, a value is invalid, or a parameter belongs to an earlier version.
    """
    try:
        values = _flat(yaml.safe_load(path.read_text())["/**"][node]["ros__parameters"])
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise SettingsError(f"'{path}' is no parameter file with /**: {node}: ros__parameters: ({error!r})") from error
    known = {about.name for about in describe()}
    return Settings().with_values({name: value for name, value in values.items() if name in known or replacement(name)})


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat

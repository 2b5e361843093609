"""Parameter files as ROS reads them, read without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from ik_node.errors import SettingsError
from ik_node.settings.groups import Settings, describe


def read_settings(path: Path, node: str = "ik_node") -> Settings:
    """The settings that ``/**: <node>: ros__parameters:`` of a file holds, defaults elsewhere.

    Parameters that are none of ours (a node has others too) are passed over. Raises SettingsError when the file is no
    such file or a value is out of range.
    """
    try:
        values = _flat(yaml.safe_load(path.read_text())["/**"][node]["ros__parameters"])
    except (OSError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise SettingsError(f"'{path}' is no parameter file with /**: {node}: ros__parameters: ({error!r})") from error
    known = {about.name for about in describe()}
    return Settings().with_values({name: value for name, value in values.items() if name in known})


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat

"""Names of parameters: those of ROS itself, and the refusal of unknown ones with the nearest valid name."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable

from ik_node.errors import SettingsError
from ik_node.settings.replaced import replacement

ROS_NAMES = ("use_sim_time", "start_type_description_service")
"""Parameters that every rclpy node has."""
ROS_PREFIXES = ("qos_overrides.",)
"""Prefixes of parameters that rclpy declares for single topics."""
NODE_NAMES = ("autostart",)
"""Parameters of the node that are not settings of the controller."""

CUTOFF = 0.5
"""Least similarity of a name that is proposed; `gain` for `gain_liner` has 0.57."""


def is_ros_name(name: str) -> bool:
    """Whether a parameter belongs to rclpy."""
    return name in ROS_NAMES or name.startswith(ROS_PREFIXES)


def check_names(names: Iterable[str], valid: Collection[str]) -> None:
    """Checks names of parameters.

    Args:
        names: Names that are used.
        valid: Names that exist.

    Raises:
        SettingsError: A name does not exist; the message has its replacement when it belongs to an earlier version,
            else the nearest valid name, else all valid names.
    """
    for name in names:
        if name not in valid:
            raise SettingsError(replacement(name) or _unknown(name, valid))


def _unknown(name: str, valid: Collection[str]) -> str:
    without_group = sorted(known for known in valid if known.rpartition(".")[2] == name)
    near = without_group or difflib.get_close_matches(name, valid, 1, CUTOFF)
    if near:
        return f"unknown parameter '{name}'; nearest: {', '.join(near)}"
    return f"unknown parameter '{name}'; valid: {', '.join(sorted(valid))}"

"""Own methods of a recorded run: those that are here by the same name, and a stand-in for those that are not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ik_node.control.controller import Controller
from ik_node.differential_ik.own_methods import OwnMethod, load_methods
from ik_node.errors import MethodFault, SettingsError
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

ABSENT = "absent"
"""Digest of a stand-in."""


def recorded_methods(robot: Robot, settings: Settings, recorded: Mapping[str, str]) -> dict[str, OwnMethod]:
    """The own methods that settings name.

    Args:
        robot: The robot of the run.
        settings: The settings.
        recorded: Own methods of the recording: name -> digest. One that cannot be loaded here is replaced by a stand-in
            that fails at every call, so that the arm continues with ``plain``.

    Raises:
        SettingsError: A method that is not recorded cannot be loaded.
    """
    methods: dict[str, OwnMethod] = {}
    for name in (*settings.control.extra_methods, settings.control.method):
        one = settings.with_values({"method": "plain", "extra_methods": (name,)}) if name in recorded else settings
        try:
            methods |= load_methods(robot, one.control, methods)
        except SettingsError as error:
            if name not in recorded:
                raise
            methods[name] = _stand_in(name, str(error))
    return methods


def method_differences(recorded: Mapping[str, str], controller: Controller) -> tuple[str, ...]:
    """One text about each recorded own method that is absent, or has another source, in a controller."""
    texts = []
    for name, digest in recorded.items():
        method = controller.method.own.get(name)
        if method is None or method.digest == ABSENT:
            texts.append(f"method '{name}': recorded source {digest or 'unknown'}, absent here; plain is used")
        elif method.digest != digest:
            texts.append(f"method '{name}': recorded source {digest or 'unknown'}, here {method.digest or 'unknown'}")
    return tuple(texts)


def _stand_in(name: str, reason: str) -> OwnMethod:
    def absent(robot: Robot, q: Array) -> Any:
        raise MethodFault(f"absent here: {reason}")

    return OwnMethod(name, absent, ABSENT)

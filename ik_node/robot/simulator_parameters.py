"""Parameters of a simulated arm: those of ``ik_simulator``, which a simulation without ROS reads, too."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ik_node.errors import SettingsError
from ik_node.math.types import Array
from ik_node.robot.simulated_arm import ArmModel
from ik_node.settings.groups import ArmSettings, describe
from ik_node.settings.names import check_names
from ik_node.settings.schema import Descriptor, check, converted

SIMULATOR = "ik_simulator"
"""Name of the node."""
ARM_NAMES = ("robot", "robot_description", "base_frame", "tip_frame", "joint_prefix")
"""Parameters that are those of ``ik_node``."""
ROBOT = "panda"
"""Default of ``robot``, unless ``robot_description`` is given."""


def _parameters() -> Iterator[Descriptor]:
    for about in describe():
        if about.name in ARM_NAMES:
            yield about._replace(read_only=True, default=ROBOT if about.name == "robot" else about.default)
    number = Descriptor("rate_hz", 500.0, "Rate of the joint states.", "Hz", 1.0, 10_000.0, (), True, float, 0)
    yield number
    start = "Joint positions at the start; without values they are chosen."
    yield number._replace(
        name="initial_position", default=(), description=start, unit="rad or m", minimum=None, maximum=None
    )
    for field in dataclasses.fields(ArmModel):
        default: Any = field.default
        yield Descriptor(**{"name": field.name, "default": default, **field.metadata, "read_only": True})


PARAMETERS = tuple(_parameters())
"""Parameters of the simulated arm, read at the start."""


def checked_values(given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters with their values.

    Args:
        given: Values of a file or command line.

    Returns:
        Name -> value, the default where none is given.

    Raises:
        SettingsError: A name is unknown, or a value is invalid.
    """
    check_names(given, [about.name for about in PARAMETERS])
    values = {about.name: converted(given.get(about.name, about.default), about) for about in PARAMETERS}
    for about in PARAMETERS:
        check(about.name, values[about.name], about)
    return values


def arm_settings(values: Mapping[str, Any]) -> ArmSettings:
    """The robot that the parameters select."""
    return ArmSettings(**{name: values[name] for name in ARM_NAMES})


def arm_model(values: Mapping[str, Any]) -> ArmModel:
    """Dynamics of the simulated arm that the parameters select."""
    return ArmModel(**{field.name: values[field.name] for field in dataclasses.fields(ArmModel)})


def start_position(values: Mapping[str, Any], joints: tuple[str, ...]) -> Array | None:
    """Configured start of the simulated arm.

    Args:
        values: All parameters.
        joints: Joints of the simulated arm.

    Returns:
        Joint positions (n,), rad (m); None if none are configured.

    Raises:
        SettingsError: Their number is not that of the joints.
    """
    start = values["initial_position"]
    if start and len(start) != len(joints):
        expected = f"expected {len(joints)}, in the order {', '.join(joints)}"
        raise SettingsError(f"initial_position of {SIMULATOR} has {len(start)} values; {expected}")
    return np.array(start, dtype=np.float64) if start else None

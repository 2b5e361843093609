"""Options of the demonstration, checked before a process starts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

from ik_node import resources
from ik_node.control.arm_configuration import arm_configuration
from ik_node.control.controller import Controller
from ik_node.control.start_posture import StartPosture, choose_start_posture
from ik_node.errors import SettingsError
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.robot.simulator_parameters import ARM_NAMES, ROBOT, SIMULATOR, arm_settings, checked_values, start_position
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import parse_assignment, read_sections, sections_in, settings_of, values_of
from ik_node.settings.schema import Value
from ik_node.trajectory import pose_file, shapes
from ik_node.trajectory.pose_file import PoseFile
from ik_node.trajectory.pose_file_format import PoseFileFormat

OWN_PARAMETERS = ("recording.enabled", "recording.directory")
"""Parameters that the demonstration sets."""


@dataclass(frozen=True)
class DemoOptions:
    """Options of the demonstration."""

    config: Path | None
    """Parameter file; None: that of the robot, if there is one, or one made from ``urdf``."""
    urdf: Path | None
    """URDF file of the arm; None: the robot is that of the parameters."""
    overrides: Mapping[str, str]
    """Parameters of the node: name -> value as YAML."""
    trajectory: str
    """A name in :data:`ik_node.trajectory.shapes.SHAPES`, or a file of poses."""
    file_format: PoseFileFormat
    target_rate_hz: float | None
    out: Path | None
    """New folder; None: a name with the robot and the time."""
    show: bool
    """Open the picture of the report where there is a screen."""
    compares_methods: bool = False
    """Run every built-in method on the same targets, instead of the configured one."""


class Configuration(NamedTuple):
    """A parameter file that exists, or one that the demonstration writes."""

    path: Path
    text: str = ""
    """Text of the file to be written; empty where it exists."""


class CheckedRun:
    """Everything that the demonstration reads from files."""

    def __init__(self, options: DemoOptions) -> None:
        """Read all files.

        Raises:
            IkNodeError: A file or parameter cannot be used, or the output folder exists.
        """
        values: dict[str, Value] = dict(
            parse_assignment(f"{name}={value}") for name, value in options.overrides.items()
        )
        self.config, sections = _configuration(options, values)
        settings = settings_of(self.config.path, sections) if self.config else Settings()
        if not (settings.arm.robot or settings.arm.robot_description):
            values.setdefault("robot", ROBOT)
        self.settings = settings.with_values(values)
        """The settings of the node."""
        arm = self.settings.arm
        self.robot: Robot = robot_from_settings(arm)
        self.robot_name = self.robot.name if arm.robot_description or not arm.robot else arm.robot
        self.simulator = checked_values(self._simulator_values(sections, values))
        """Parameters of the simulated arm; its start is configured, or chosen for the obstacles of the settings."""
        Controller(self.robot, self.settings)  # checks limits, obstacles and everything else that the node will use
        self.start: StartPosture | None = None
        """The start of the simulated arm if it was chosen."""
        self.simulated_robot = self._check_simulator()
        """The robot of the simulated arm."""
        self.poses: PoseFile | None = None
        """The file of poses; None for a shape."""
        if options.trajectory not in shapes.SHAPES:
            if not Path(options.trajectory).exists():
                valid = ", ".join(shapes.SHAPES)
                raise SettingsError(f"no trajectory '{options.trajectory}'; valid: {valid}, or a file of poses")
            self.poses = pose_file.read(options.trajectory, options.file_format)
        name = re.sub(r"[^\w.-]", "_", self.robot_name)
        self.out = options.out or Path(f"ik_demo_{name}_{datetime.now():%Y%m%d-%H%M%S}")
        """The new folder."""
        if self.out.exists():
            raise SettingsError(f"folder '{self.out}' exists already; it is not overwritten")

    def _simulator_values(self, sections: dict[str, dict[str, Any]], overrides: Mapping[str, Value]) -> dict[str, Any]:
        """Parameters of the simulated arm: those of the command line, of its section, else of the node."""
        arm = self.settings.arm
        of_node = {name: getattr(arm, name) for name in ARM_NAMES} | {"rate_hz": self.settings.control.rate_hz}
        given = {name: overrides[name] for name in of_node if name in overrides}
        return of_node | (values_of(sections, SIMULATOR) or {}) | given

    def _check_simulator(self) -> Robot:
        robot = robot_from_settings(arm_settings(self.simulator))
        missing = [name for name in self.robot.joints if name not in robot.joints]
        if missing:
            raise SettingsError(
                f"{SIMULATOR} has no joint {', '.join(missing)}; its parameters describe another arm with the joints "
                f"{', '.join(robot.joints)}"
            )
        if start_position(self.simulator, robot.joints) is None:
            self.start = choose_start_posture(robot, self.settings)
            self.simulator["initial_position"] = tuple(self.start.position.tolist())
        return robot


def checked_overrides(assignments: Sequence[str]) -> dict[str, str]:
    """The parameters ``NAME=VALUE`` of a command line as a dictionary.

    Raises:
        IkNodeError: An assignment is invalid, a parameter is set twice, or by the demonstration.
    """
    found: dict[str, str] = {}
    for assignment in assignments:
        name, _ = parse_assignment(assignment)
        if name in found:
            raise SettingsError(f"--set {name}=... is given twice; expected once")
        if name in OWN_PARAMETERS:
            raise SettingsError(f"--set {assignment} has no effect: the demonstration sets {', '.join(OWN_PARAMETERS)}")
        found[name] = assignment.partition("=")[2]
    return found


def _configuration(
    options: DemoOptions, values: Mapping[str, Value]
) -> tuple[Configuration | None, dict[str, dict[str, Any]]]:
    """The parameter file and its sections; None where there is none and the defaults apply."""
    if options.urdf is not None and options.config is None:
        frames = (str(values.get(name, "")) for name in ("base_frame", "tip_frame"))
        text = arm_configuration(options.urdf, *frames)
        return Configuration(Path("ik_node.yaml"), text), sections_in(text, options.urdf)
    existing = options.config or _config_for(str(values.get("robot", ROBOT)))
    return (None, {}) if existing is None else (Configuration(existing), read_sections(existing))


def _config_for(robot: str) -> Path | None:
    """Return the configuration file of a robot; None where there is none."""
    try:
        return resources.config_file(f"{robot}.yaml")
    except SettingsError:
        return None

"""Options of the demonstration, checked before a process starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from ik_node import resources
from ik_node.collision.scene import read_scene
from ik_node.control.start_posture import StartPosture, choose_start_posture
from ik_node.errors import SettingsError
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import addresses, parse_assignment, read_sections, read_settings
from ik_node.settings.schema import Value
from ik_node.trajectory import pose_file, shapes
from ik_node.trajectory.pose_file import PoseFile
from ik_node.trajectory.pose_file_format import PoseFileFormat

SIMULATOR = "ik_simulator"
"""Name of the node of the simulated arm."""
DEFAULT_ROBOT = "panda"
OWN_PARAMETERS = ("recording.enabled", "recording.directory")
"""Parameters that the demonstration sets."""
ARM_PARAMETERS = ("robot", "robot_description", "base_frame", "tip_frame", "joint_prefix")
"""Parameters that the simulator has, too."""


@dataclass(frozen=True)
class DemoOptions:
    """Options of the demonstration."""

    config: Path | None
    """Parameter file; None: that of the robot, if there is one."""
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


class CheckedRun:
    """Everything that the demonstration reads from files."""

    def __init__(self, options: DemoOptions) -> None:
        """Read all files.

        Raises:
            IkNodeError: A file or parameter cannot be used, or the output folder exists.
        """
        self.config = options.config or _config_for(options.overrides.get("robot", DEFAULT_ROBOT))
        """The parameter file; None where there is none and the defaults apply."""
        settings = Settings() if self.config is None else read_settings(self.config)
        values: dict[str, Value] = dict(
            parse_assignment(f"{name}={value}") for name, value in options.overrides.items()
        )
        if not (settings.arm.robot or settings.arm.robot_description):
            values.setdefault("robot", DEFAULT_ROBOT)
        self.settings = settings.with_values(values)
        """The settings of the node."""
        self.robot: Robot = robot_from_settings(self.settings.arm)
        self.robot_name = self.settings.arm.robot or Path(str(self.config)).stem
        if scene := self.settings.obstacles.scene:
            read_scene(scene, lambda frame: self.robot.frame_pose(np.zeros(self.robot.n), frame))
        self.start: StartPosture | None = None
        """The start of the simulated arm, chosen for these obstacles; None where it is configured."""
        if not _is_start_configured(self.config):
            self.start = choose_start_posture(self.robot, self.settings)
        self.poses: PoseFile | None = None
        """The file of poses; None for a shape."""
        if options.trajectory not in shapes.SHAPES:
            if not Path(options.trajectory).exists():
                valid = ", ".join(shapes.SHAPES)
                raise SettingsError(f"no trajectory '{options.trajectory}'; valid: {valid}, or a file of poses")
            self.poses = pose_file.read(options.trajectory, options.file_format)
        self.out = options.out or Path(f"ik_demo_{self.robot_name}_{datetime.now():%Y%m%d-%H%M%S}")
        """The new folder."""
        if self.out.exists():
            raise SettingsError(f"folder '{self.out}' exists already; it is not overwritten")


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


def _is_start_configured(config: Path | None) -> bool:
    """Whether a parameter file has the start of the simulated arm."""
    sections = {} if config is None else read_sections(config)
    return any("initial_position" in values for name, values in sections.items() if addresses(name, SIMULATOR))


def _config_for(robot: str) -> Path | None:
    """Return the configuration file of a robot; None where there is none and the defaults apply."""
    try:
        return resources.config_file(f"{robot}.yaml")
    except SettingsError:
        return None

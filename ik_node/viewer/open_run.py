"""A recorded run -> a page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ik_node.collision.scene import Scene, read_scene
from ik_node.errors import IkNodeError, RobotError
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.metrics import robot_name
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.viewer import meshes
from ik_node.viewer.meshes import Part
from ik_node.viewer.page import Page, Subject
from ik_node.viewer.recorded_scene import RecordedObstacles, scenes_of
from ik_node.viewer.timeline import film_of


def open_run(server: Any, run: Run, name: str = "", obstacles: RecordedObstacles | None = None) -> Page:
    """A page of ``run`` on a viser server; ``name`` stands in its title."""
    settings = settings_of(run)
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, settings.arm.joint_prefix)
    parts, notes = look_of(robot, settings.obstacles.package_path)
    known = obstacles or RecordedObstacles(None, ())
    first, about_scene = (known.first, ()) if known.first else first_scene(robot, settings.obstacles.scene)
    notes += about_scene
    if known.missing:
        notes += (f"Obstacles that came and went are not shown: {known.missing}",)
    if not run.complete:
        notes += ("This recording was cut off; ik_repair makes it whole.",)
    targets, film = _targets(run), film_of(run)
    subject = Subject(
        title=", ".join(part for part in (run.robot or robot_name(run.urdf), "/".join(Path(name).parts[-2:])) if part),
        robot=robot,
        parts=parts,
        velocity_limits=run.velocity_limits,
        mass_weighted=settings.control.method != "plain",
        scene_at=scenes_of(robot, first, known.arrivals, lambda time_s: film.q[film.row(time_s)]),
        targets=lambda: targets,
        notes=notes,
    )
    return Page(server, subject, lambda: film)


def settings_of(run: Run) -> Settings:
    """The settings of a run, as far as this version knows them."""
    known = Settings().flat()
    return Settings().with_values({name: value for name, value in run.settings.items() if name in known})


def look_of(robot: Robot, folders: tuple[str, ...] = ()) -> tuple[tuple[Part, ...], tuple[str, ...]]:
    """The meshes of ``robot``; where there are none, nothing and a note that says why."""
    try:
        return meshes.load(robot, folders), ()
    except RobotError as error:
        return (), (f"No meshes, so lines from joint to joint. {error}",)


def first_scene(robot: Robot, path: str) -> tuple[Scene, tuple[str, ...]]:
    """The obstacles of the file that a run began with; a note where that cannot be read here."""
    if not path:
        return Scene(), ()
    try:
        return read_scene(path, lambda frame: robot.frame_pose(np.zeros(robot.n), frame)), ()
    except IkNodeError as error:
        return Scene(), (f"The run's obstacles are not shown: {error}",)


def _targets(run: Run) -> Array:
    """Positions of the targets that are in the base frame, (m, 3)."""
    known = np.array([frame in ("", run.base_frame) for frame in run.targets.frame_ids], dtype=bool)
    return np.asarray(run.targets.position[known])

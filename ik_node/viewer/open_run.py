"""Opens the page of a recorded run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ik_node.collision.scene import Scene, read_scene
from ik_node.errors import IkNodeError, RobotError
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.clearances import settings_of
from ik_node.report.extremes import gradient_gains
from ik_node.report.metrics import RunMetrics
from ik_node.report.quantities import UNWEIGHTED
from ik_node.report.recorded_scene import RecordedObstacles, scene_history
from ik_node.report.run_tasks import run_tasks
from ik_node.robot.robot import Robot
from ik_node.viewer import meshes
from ik_node.viewer.meshes import MeshPart
from ik_node.viewer.page import PageContent, ViewerPage
from ik_node.viewer.status_html import verdict_html
from ik_node.viewer.timeline import Timeline, timeline_of


def open_run(
    server: Any,
    run: Run,
    name: str = "",
    obstacles: RecordedObstacles | None = None,
    metrics: RunMetrics | None = None,
) -> ViewerPage:
    """Builds the page of a recorded run.

    Args:
        server: viser.ViserServer.
        run: The recorded run.
        name: Path of the recording; its end is shown in the title.
        obstacles: Result of :func:`~ik_node.report.recorded_scene.read_obstacles`; without it, only the obstacles of
            the run's scene file are shown.
        metrics: Metrics of the run, for its verdict; without them none is shown.

    Raises:
        RobotError: The robot model of the run is invalid.
        MissingPackageError: trimesh is not installed.
    """
    settings = settings_of(run)
    robot = Robot(run.urdf, run.base_frame, run.tip_frame, run.joints, settings.arm.joint_prefix)
    parts, notes = load_meshes(robot, settings.obstacles.package_path)
    recorded = obstacles or RecordedObstacles(None, ())
    first, scene_notes = (recorded.first, ()) if recorded.first else first_scene(robot, settings.obstacles.scene)
    notes += scene_notes
    if recorded.missing:
        notes += (f"Obstacle messages of the run are not shown: {recorded.missing}",)
    if not run.complete:
        notes += ("This recording is truncated; ik_repair completes it.",)
    targets, timeline, gains = _targets(run), timeline_of(run), gradient_gains(run)
    content = PageContent(
        title=", ".join(filter(None, (run.robot or robot.name, "/".join(Path(name).parts[-2:])))),
        robot=robot,
        parts=parts,
        velocity_limits=run.velocity_limits,
        mass_weighted=settings.control.method not in UNWEIGHTED,
        gradient_gain=lambda time_s: float(gains[timeline.row(time_s)]),
        scene_at=scene_history(robot, first, recorded.arrivals, lambda time_s: run.q[timeline.row(time_s)]),
        tolerance_at=_tolerances(run, timeline),
        targets=lambda: targets,
        to_trajectory=None if metrics is None else _to_trajectory(metrics),
        verdict_html="" if metrics is None else verdict_html(metrics),
        notes=notes,
    )
    return ViewerPage(server, content, lambda: timeline)


def _tolerances(run: Run, timeline: Timeline) -> Callable[[float], TaskTolerance]:
    tasks = run_tasks(run)
    indices = np.argmax([task.rows for task in tasks], axis=0)
    return lambda time_s: tasks[int(indices[timeline.row(time_s)])].tolerance


def _to_trajectory(metrics: RunMetrics) -> Callable[[Array], Array] | None:
    series = metrics.series
    if series is None or not len(series.times_s):
        return None
    times_s, error = series.times_s, series.tool_to_trajectory.position

    def at(query_s: Array) -> Array:
        result: Array = np.interp(query_s, times_s, error)
        return result

    return at


def load_meshes(robot: Robot, folders: tuple[str, ...] = ()) -> tuple[tuple[MeshPart, ...], tuple[str, ...]]:
    """Visual geometry for a page.

    Args:
        robot: The robot.
        folders: Additional folders for ``package://`` names.

    Returns:
        The meshes and no note, or no mesh and a note with the reason.
    """
    try:
        return meshes.load(robot, folders), ()
    except RobotError as error:
        return (), (f"The robot is drawn as lines between its joints: {error}",)


def first_scene(robot: Robot, path: str) -> tuple[Scene, tuple[str, ...]]:
    """Obstacles of a scene file for a page.

    Args:
        robot: The robot; its frames at q = 0 place obstacles that are given in a frame of the arm.
        path: The file; empty for none.

    Returns:
        The scene and no note, or an empty scene and a note with the reason.
    """
    if not path:
        return Scene(), ()
    try:
        return read_scene(path, lambda frame: robot.frame_pose(np.zeros(robot.n), frame)), ()
    except IkNodeError as error:
        return Scene(), (f"The obstacles of the scene file are not shown: {error}",)


def _targets(run: Run) -> Array:
    """Positions of the targets that were given in the base frame, (m, 3), m."""
    known = np.array([frame in ("", run.base_frame) for frame in run.targets.frame_ids], dtype=bool)
    return np.asarray(run.targets.position[known])

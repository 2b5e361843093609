"""Distances to obstacles apart from those between links, from the recorded positions and obstacles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.collision.avoidance import repulsion
from ik_node.collision.distance_kernels import NearPairs
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import Scene, read_scene
from ik_node.errors import IkNodeError
from ik_node.math.types import Array
from ik_node.recording.run import Run
from ik_node.report.recorded_scene import ClosestPointQuery, RecordedObstacles, SceneHistory, scene_history
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings, Settings

ROWS = 300
"""Positions at which the distances are computed, evenly spaced over the run."""
RANGE_M = 2.0
"""Distances beyond this are not computed."""


class ClearanceMetrics(NamedTuple):
    """Smallest distance."""

    least: float
    """m; NaN if no distance was computed."""
    time_s: float
    pair: tuple[str, ...]
    """Names of the closest pair."""


NO_CLEARANCE = ClearanceMetrics(math.nan, math.nan, ())


class ClearanceSeries(NamedTuple):
    """Distances at some control steps, (r,); NaN where there is no pair of that kind."""

    times_s: Array
    """On the axis of ``Run.times_s``."""
    obstacle: Array
    """Arm to the nearest obstacle, m."""
    own: Array
    """Between the nearest links, m."""
    repulsion: Array
    """Repulsive potential h(q), J."""
    least_obstacle: ClearanceMetrics
    least_own: ClearanceMetrics


def settings_of(run: Run) -> Settings:
    """The recorded settings; parameters that do not exist in this version are ignored."""
    known = Settings().flat()
    return Settings().with_values({name: value for name, value in run.settings.items() if name in known})


def recorded_clearance(run: Run) -> ClearanceMetrics:
    """The smallest recorded distance, to an obstacle or between links."""
    finite = np.isfinite(run.clearance)
    if not finite.any():
        return NO_CLEARANCE
    row = int(np.where(finite, run.clearance, np.inf).argmin())
    return ClearanceMetrics(float(run.clearance[row]), float(run.times_s[row]), run.closest_pair[row])


def clearances(run: Run, robot: Robot, obstacles: RecordedObstacles | None = None) -> ClearanceSeries | None:
    """Distances of a run.

    Args:
        run: The recorded run.
        robot: Its robot.
        obstacles: Its obstacles; default: those of the scene file, when that still exists.

    Returns:
        None when the geometry of the robot is not available.
    """
    settings = settings_of(run).obstacles
    scenes = _scenes(run, robot, settings, obstacles)
    query = ClosestPointQuery(robot, settings)
    rows = _rows(run)
    if not len(rows) or query.distances_at(Scene()) is None:
        return None
    found = [_measured(query, run.q[row], scenes(float(run.times_s[row])), settings) for row in rows.tolist()]
    times_s = run.times_s[rows]
    return ClearanceSeries(
        times_s,
        np.array([entry.obstacle.least for entry in found]),
        np.array([entry.own.least for entry in found]),
        np.array([entry.repulsion for entry in found]),
        _least([entry.obstacle for entry in found], times_s),
        _least([entry.own for entry in found], times_s),
    )


class _Measured(NamedTuple):
    obstacle: ClearanceMetrics
    own: ClearanceMetrics
    repulsion: float


def _measured(query: ClosestPointQuery, q: Array, scene: Scene, settings: ObstacleSettings) -> _Measured:
    distances = query.distances_at(scene)
    if distances is None:
        return _Measured(NO_CLEARANCE, NO_CLEARANCE, math.nan)
    near, _ = distances.measure(q, RANGE_M)
    return _Measured(
        _nearest(distances, near, near.self_collision == 0.0),
        _nearest(distances, near, near.self_collision > 0.0),
        repulsion(near, len(near.distance), settings).value,
    )


def _nearest(distances: DistanceQuery, near: NearPairs, wanted: NDArray[np.bool_]) -> ClearanceMetrics:
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return NO_CLEARANCE
    row = int(rows[near.distance[rows].argmin()])
    return ClearanceMetrics(float(near.distance[row]), math.nan, distances.names(int(near.pair[row])))


def _least(found: list[ClearanceMetrics], times_s: Array) -> ClearanceMetrics:
    known = [(entry.least, index) for index, entry in enumerate(found) if math.isfinite(entry.least)]
    if not known:
        return NO_CLEARANCE
    index = min(known)[1]
    return found[index]._replace(time_s=float(times_s[index]))


def _rows(run: Run) -> NDArray[np.int64]:
    """Control steps with a measured position, and that of the smallest recorded distance."""
    known = np.flatnonzero(np.isfinite(run.q).all(axis=1))
    picked = known[np.unique(np.linspace(0, len(known) - 1, ROWS).round().astype(np.int64))] if len(known) else known
    finite = np.isfinite(run.clearance[known])
    if finite.any():
        picked = np.union1d(picked, known[finite][run.clearance[known][finite].argmin()])
    return np.asarray(picked)


def _scenes(run: Run, robot: Robot, settings: ObstacleSettings, obstacles: RecordedObstacles | None) -> SceneHistory:
    recorded = obstacles or RecordedObstacles(None, ())
    first = recorded.first
    if first is None and settings.scene:
        try:
            first = read_scene(settings.scene, lambda frame: robot.frame_pose(np.zeros(robot.n), frame))
        except IkNodeError:  # the file is no longer there
            first = None

    def position(time_s: float) -> Array:
        return np.asarray(run.q[max(int(np.searchsorted(run.times_s, time_s, side="right")) - 1, 0)])

    return scene_history(robot, first, recorded.arrivals, position)

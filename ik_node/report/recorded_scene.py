"""Obstacles over time, and the closest points of obstacles and arm."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import ClosestPair, DistanceQuery
from ik_node.collision.monitor import UPRIGHT
from ik_node.collision.scene import Obstacle, Scene, obstacle, shape
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import InputError, RecordingError, RobotError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall, RecordedCalls, decode_snapshot
from ik_node.recording.input_table import OBSTACLES
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings

SceneAt = Callable[[float], Scene]
"""Time on the axis of the timeline, s -> obstacles at that time."""

ObstacleArrival = tuple[float, tuple[ObstacleSample, ...]]
"""Time of arrival on the axis of the timeline, s, and the obstacles of one message."""


class SceneHistory:
    """The scenes of a run; arrivals are added in order of time."""

    def __init__(self, robot: Robot, first: Scene | None = None) -> None:
        """``first``: the scene before the first arrival."""
        self._robot = robot
        self._times_s = [-np.inf]
        self._scenes = [first or Scene()]

    def add(self, arrival: ObstacleArrival, q: Array) -> None:
        """Applies a message as the controller does; invalid obstacles are skipped.

        Args:
            arrival: Time and obstacles.
            q: Joint positions at that time, (n,), for obstacles given in a frame of the arm.
        """
        time_s, samples = arrival
        scene = self._scenes[-1]
        for sample in samples:
            try:
                scene = self._apply(scene, sample, time_s, q)
            except (InputError, RobotError):  # the controller reports it in its status
                continue
        self._times_s.append(time_s)
        self._scenes.append(scene)

    def __call__(self, time_s: float) -> Scene:
        """The obstacles at a time, with moving obstacles extrapolated to it."""
        time_ns = round(time_s * NS)
        scene = self._scenes[bisect.bisect_right(self._times_s, time_s) - 1].at(time_ns)
        return Scene({name: entry.at(time_ns) for name, entry in scene.obstacles.items()})

    def _apply(self, scene: Scene, sample: ObstacleSample, time_s: float, q: Array) -> Scene:
        if sample.action == "delete_all":
            return scene.remove_all(sample.name.rpartition("/")[0])
        if sample.action == "delete":
            return scene.remove(sample.name)
        time_ns = round(time_s * NS)
        expires_ns = time_ns + sample.lifetime_ns if sample.lifetime_ns > 0 else None
        quaternion = UPRIGHT if sample.kind == "sphere" else sample.quaternion
        pose = se3.pose_from(sample.position, quaternion, sample.name)
        if sample.frame_id not in ("", self._robot.base_frame):
            pose = self._robot.frame_pose(q, sample.frame_id) @ pose
        solid = shape(sample.kind, sample.size, sample.name)
        return scene.put(obstacle(sample.name, solid, pose, time_ns, expires_ns=expires_ns))


class RecordedObstacles(NamedTuple):
    """The obstacles of a recording; times on the axis of its timeline."""

    first: Scene | None
    """Scene at the start of the run; None if it is not recorded."""
    arrivals: tuple[ObstacleArrival, ...]
    missing: str = ""
    """Reason why they cannot be read; otherwise empty."""

    @property
    def at_start(self) -> tuple[Obstacle, ...]:
        """The obstacles of the first scene."""
        return () if self.first is None else tuple(self.first.obstacles.values())


def read_obstacles(path: str | Path, node: str = "") -> RecordedObstacles:
    """Reads the obstacles of a recording.

    Args:
        path: Folder or MCAP file of the recording.
        node: Full name of the node; empty if the recording has only one.

    Returns:
        The obstacles; for a recording of an incompatible version, ``missing`` gives the reason.
    """
    try:
        return _read_obstacles(RecordedCalls(path, node))
    except RecordingError as error:
        return RecordedObstacles(None, (), str(error))


def _read_obstacles(calls: RecordedCalls) -> RecordedObstacles:
    text, topic = calls.head.snapshot, calls.head.setup["inputs"].get(OBSTACLES)
    snapshot = None if text is None else decode_snapshot(text, ControllerSnapshot)
    scene = Scene() if snapshot is None else snapshot.scene
    any_received = any(channel.name == topic and count for channel, count in calls.recording.counts().items())
    if not (any_received or scene.obstacles):
        return RecordedObstacles(None if snapshot is None else scene, ())
    start_ns: int | None = None
    arrivals = []
    for event in calls.entries():
        if isinstance(event, RecordedCall):
            if start_ns is None and event.step is not None:
                start_ns = event.call.now.monotonic_ns
            if event.call.kind is CallKind.ON_OBSTACLES:
                arrivals.append((event.call.now.monotonic_ns, decode_obstacles(event.data)))
    zero_ns = start_ns or 0
    return RecordedObstacles(
        None if snapshot is None else _shifted(scene, -zero_ns),
        tuple(((time_ns - zero_ns) / NS, samples) for time_ns, samples in arrivals),
    )


def _shifted(scene: Scene, by_ns: int) -> Scene:
    """The scene with its times shifted by ``by_ns``."""
    return Scene(
        {
            name: entry._replace(
                time_ns=entry.time_ns + by_ns,
                expires_ns=None if entry.expires_ns is None else entry.expires_ns + by_ns,
            )
            for name, entry in scene.obstacles.items()
        }
    )


def scene_history(
    robot: Robot, first: Scene | None, arrivals: Sequence[ObstacleArrival], q_at: Callable[[float], Array]
) -> SceneHistory:
    """The scenes of a recorded run.

    Args:
        robot: The robot.
        first: Scene at the start.
        arrivals: Obstacle messages in order of time.
        q_at: Time in s -> joint positions, (n,).
    """
    scenes = SceneHistory(robot, first)
    for arrival in arrivals:
        scenes.add(arrival, q_at(arrival[0]))
    return scenes


class ClosestPointQuery:
    """Closest points of arm and obstacles; the geometry is loaded at the first query. Not thread-safe."""

    def __init__(self, robot: Robot, settings: ObstacleSettings) -> None:
        self._robot = robot
        self._settings = settings
        self._query: DistanceQuery | None = None
        self.unavailable = "obstacles.geometry is none" if settings.geometry == "none" else ""
        """Reason why no distance can be computed; otherwise empty."""

    def closest(self, q: Array, scene: Scene) -> ClosestPair | None:
        """The closest pair of arm and obstacles, or of two links of the arm.

        Args:
            q: Joint positions, (n,).
            scene: Obstacles at the current time.

        Returns:
            None if there is no pair, no geometry, or a joint position is NaN.
        """
        query = self.distances_at(scene)
        if query is None or not np.isfinite(q).all():
            return None
        closest = query.measure(q, 0.0)[1]
        return closest if np.isfinite(closest.distance) else None

    def distances_at(self, scene: Scene) -> DistanceQuery | None:
        """The distance computation with these obstacles at the current time; None if there is no geometry."""
        query = self._loaded_query()
        if query is not None:
            # The poses are those of the current time already: without velocities they are not extrapolated.
            static = {name: obstacle(name, entry.shape, entry.pose_s) for name, entry in scene.obstacles.items()}
            query.set_scene(Scene(static), 0)
        return query

    def _loaded_query(self) -> DistanceQuery | None:
        if self._query is None and not self.unavailable:
            settings = self._settings
            try:
                geometry = collision_geometry.load(
                    self._robot,
                    settings.geometry,
                    settings.package_path,
                    settings.srdf,
                    settings.ignored_pairs,
                    settings.watched_pairs,
                    settings.self_collision,
                )
                self._query = DistanceQuery(geometry)
            except RobotError as error:
                self.unavailable = str(error)
        return self._query

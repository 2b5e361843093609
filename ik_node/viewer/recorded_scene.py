"""Obstacles over time, and what of them is nearest to the arm."""

from __future__ import annotations

import bisect
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ik_node.collision import geometry as collision_geometry
from ik_node.collision.distances import Clearance, Closest
from ik_node.collision.scene import Scene, obstacle, shape
from ik_node.errors import InputError, RecordingError, RobotError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.messages.decode_obstacles import decode_obstacles
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import Event, RecordedCalls
from ik_node.recording.input_table import OBSTACLES
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings

SceneAt = Callable[[float], Scene]
"""The obstacles as they were at a time of the film."""

Arrival = tuple[float, tuple[ObstacleSample, ...]]
"""What arrived at a time of the film, s."""


class Scenes:
    """Every scene that there was. To be added to in the order of time."""

    def __init__(self, robot: Robot, first: Scene | None = None) -> None:
        """``first``: what was there before anything arrived."""
        self._robot = robot
        self._times_s = [-np.inf]
        self._scenes = [first or Scene()]

    def add(self, arrival: Arrival, q: Array) -> None:
        """Takes obstacles as the controller does; ``q`` (n,) places frames that the arm moves. What cannot be used is
        left out, as the controller left it out."""
        time_s, samples = arrival
        scene = self._scenes[-1]
        for sample in samples:
            try:
                scene = self._with(scene, sample, time_s, q)
            except (InputError, RobotError):  # the controller's status says so
                continue
        self._times_s.append(time_s)
        self._scenes.append(scene)

    def __call__(self, time_s: float) -> Scene:
        """Those there at a time, where they were then."""
        time_ns = round(time_s * NS)
        found = self._scenes[bisect.bisect_right(self._times_s, time_s) - 1].at(time_ns)
        return Scene({name: entry.at(time_ns) for name, entry in found.obstacles.items()})

    def _with(self, scene: Scene, sample: ObstacleSample, time_s: float, q: Array) -> Scene:
        if sample.action == "delete_all":
            return Scene()
        if sample.action == "delete":
            return scene.remove(sample.name)
        time_ns = round(time_s * NS)
        expires_ns = time_ns + sample.lifetime_ns if sample.lifetime_ns > 0 else None
        pose = se3.pose_from(sample.position, sample.quaternion, sample.name)
        if sample.frame_id not in ("", self._robot.base_frame):
            pose = self._robot.frame_pose(q, sample.frame_id) @ pose
        solid = shape(sample.kind, sample.size, sample.name)
        return scene.put(obstacle(sample.name, solid, pose, time_ns, expires_ns=expires_ns))


class RecordedObstacles(NamedTuple):
    """What a recording holds of obstacles; times on the axis of its film."""

    first: Scene | None
    """Those that the run began with, where the recording says so."""
    arrivals: tuple[Arrival, ...]
    missing: str = ""
    """Why they cannot be told; empty where they can."""


def read_obstacles(path: str | Path, node: str = "") -> RecordedObstacles:
    """The obstacles of a recorded run. Runs of other versions can be looked at without."""
    try:
        return _read_obstacles(RecordedCalls(path, node))
    except RecordingError as error:
        return RecordedObstacles(None, (), str(error))


def _read_obstacles(calls: RecordedCalls) -> RecordedObstacles:
    state, topic = calls.head.state, calls.head.setup["inputs"].get(OBSTACLES)
    scene = Scene() if state is None else state.scene
    some = any(known.name == topic and count for known, count in calls.recording.counts().items())
    if not (some or scene.obstacles):
        return RecordedObstacles(None if state is None else scene, ())
    start_ns: int | None = None
    arrivals = []
    for event in calls.events():
        if isinstance(event, Event):
            if start_ns is None and event.step is not None:
                start_ns = event.call.now.monotonic_ns
            if event.call.kind is CallKind.ON_OBSTACLES:
                arrivals.append((event.call.now.monotonic_ns, decode_obstacles(event.data)))
    zero_ns = start_ns or 0
    return RecordedObstacles(
        None if state is None else _shifted(scene, -zero_ns),
        tuple(((time_ns - zero_ns) / NS, samples) for time_ns, samples in arrivals),
    )


def _shifted(scene: Scene, by_ns: int) -> Scene:
    """The same obstacles on another clock."""
    return Scene(
        {
            name: entry._replace(
                time_ns=entry.time_ns + by_ns,
                expires_ns=None if entry.expires_ns is None else entry.expires_ns + by_ns,
            )
            for name, entry in scene.obstacles.items()
        }
    )


def scenes_of(robot: Robot, first: Scene | None, arrivals: Sequence[Arrival], q_at: Callable[[float], Array]) -> Scenes:
    """The scenes of a recorded run; ``q_at``: joint positions (n,) at a time."""
    scenes = Scenes(robot, first)
    for arrival in arrivals:
        scenes.add(arrival, q_at(arrival[0]))
    return scenes


class Nearby:
    """What is nearest to the arm; belongs to the thread of its robot. Nothing is loaded before it is asked for."""

    def __init__(self, robot: Robot, settings: ObstacleSettings) -> None:
        self._robot = robot
        self._settings = settings
        self._clearance: Clearance | None = None
        self.unavailable = "obstacles.geometry is none" if settings.geometry == "none" else ""
        """Why there is no nearest point; empty where there is one, or nobody has asked yet."""

    def closest(self, q: Array, scene: Scene) -> Closest | None:
        """The nearest points of arm and obstacles, or of two links of the arm, at q (n,); None where there are none."""
        clearance = self._loaded()
        if clearance is None or not np.isfinite(q).all():
            return None
        # They are where they are at this moment already: nothing is to be carried on.
        at_rest = {name: obstacle(name, entry.shape, entry.pose_s) for name, entry in scene.obstacles.items()}
        clearance.see(Scene(at_rest), 0)
        found = clearance.measure(q, np.zeros(clearance.pairs))[1]
        return found if np.isfinite(found.distance) else None

    def _loaded(self) -> Clearance | None:
        if self._clearance is None and not self.unavailable:
            wanted = self._settings
            try:
                geometry = collision_geometry.load(
                    self._robot,
                    wanted.geometry,
                    wanted.package_path,
                    wanted.srdf,
                    wanted.ignored_pairs,
                    wanted.watched_pairs,
                    wanted.self_collision,
                )
                self._clearance = Clearance(geometry)
            except RobotError as error:
                self.unavailable = str(error)
        return self._clearance

"""Collision monitor: the collision geometry of one arm and the obstacles around it, queried at each control step."""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np

from ik_node.collision import geometry as collision_geometry
from ik_node.collision import pair_selection
from ik_node.collision.avoidance import AvoidanceTerms, avoidance_terms
from ik_node.collision.distances import DistanceQuery
from ik_node.collision.scene import Obstacle, Scene, obstacle, put_into, read_scene, shape
from ik_node.errors import CollisionUnavailableError, InputError
from ik_node.interfaces.clock import Instant, to_monotonic
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings

MAX_REPORTED = 5
"""Refused obstacles of one message that the status names."""
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
"""Orientation of spheres, x y z w."""


class CollisionMonitor:
    """Distances, velocity dampers and repulsive potential of one arm in a scene that may change."""

    def __init__(self, robot: Robot, settings: ObstacleSettings) -> None:
        """Builds the collision geometry. When that fails, :attr:`unavailable` holds the reason.

        Args:
            robot: The robot.
            settings: Geometry, link pairs, ranges, and the path of an initial scene.

        Raises:
            SceneError: The scene file cannot be used.
            UnknownNameError: A pair in the settings names a link that does not exist.
        """
        self._settings = settings
        self._distances: DistanceQuery | None = None
        self.unavailable = ""
        """Why no distances are computed; empty when they are."""
        self.scene = Scene()
        """The obstacles."""
        self._samples: dict[str, tuple[ObstacleSample, Obstacle]] = {}
        """Last sample in the base frame and its obstacle, by name."""
        if settings.geometry == "none":
            self.unavailable = "obstacles.geometry is none"
        else:
            try:
                geometry = collision_geometry.load(
                    robot,
                    settings.geometry,
                    settings.package_path,
                    settings.srdf,
                    settings.ignored_pairs,
                    settings.watched_pairs,
                    settings.self_collision,
                )
                self._distances = DistanceQuery(geometry)
            except CollisionUnavailableError as error:
                self.unavailable = str(error)
        if settings.scene:
            at_zero = np.zeros(robot.n)
            self.scene = read_scene(settings.scene, lambda frame: robot.frame_pose(at_zero, frame))

    @property
    def digest(self) -> str:
        """Hash of the collision solids and watched pairs; :attr:`unavailable` when there are none."""
        if self._distances is None:
            return self.unavailable
        geometry = self._distances.geometry
        digest = hashlib.sha256(repr(geometry.watched()).encode())
        for link in geometry.links:
            digest.update(f"{link.name} {type(link.solid).__name__}".encode())
            digest.update(link.points.tobytes() + link.placement.homogeneous.tobytes())
        return digest.hexdigest()[:16]

    @property
    def pairs(self) -> str:
        """Text: number of watched link pairs, and the reasons for which others are not watched."""
        if self._distances is None:
            return f"no distances are computed: {self.unavailable}"
        return pair_selection.summary(self._distances.geometry.pairs)

    def configure(self, settings: ObstacleSettings) -> None:
        """Applies changed settings; read-only settings keep their values."""
        self._settings = settings

    def update_obstacles(
        self, samples: tuple[ObstacleSample, ...], frames: Frames, now: Instant, max_age_ns: int
    ) -> str:
        """Adds, changes and deletes obstacles.

        Args:
            samples: Obstacles of one message.
            frames: Frames in which their poses may be expressed.
            now: Time of arrival.
            max_age_ns: A stamp older than this is not trusted; the time of arrival is used instead.

        Returns:
            The errors of samples that cannot be used, with their names, at most :data:`MAX_REPORTED`, and the number of
            further ones; empty when all samples were used.
        """
        errors = []
        obstacles = dict(self.scene.obstacles)
        for sample in samples:
            try:
                if sample.action == "add":
                    self._add(obstacles, sample, frames, now, max_age_ns)
                else:
                    obstacles = _without(obstacles, sample)
            except InputError as error:
                errors.append(f"{sample.name}: {error}")
        self.scene = Scene(obstacles)
        self._samples = {name: pair for name, pair in self._samples.items() if obstacles.get(name) is pair[1]}
        more = [f"and {len(errors) - MAX_REPORTED} more"] if len(errors) > MAX_REPORTED else []
        return "; ".join(errors[:MAX_REPORTED] + more)

    def _add(
        self, obstacles: dict[str, Obstacle], sample: ObstacleSample, frames: Frames, now: Instant, max_age_ns: int
    ) -> None:
        name = sample.name
        stamped = to_monotonic(sample.stamp_ns, now, max_age_ns)
        expires_ns = stamped.received_ns + sample.lifetime_ns if sample.lifetime_ns > 0 else None
        # Most obstacles of most messages are where they were.
        before, old = self._samples.get(name, _NO_SAMPLE)
        if old is not None and obstacles.get(name) is old and _is_same(sample, before) and not old.moves:
            new = old._replace(time_ns=stamped.time_ns, expires_ns=expires_ns)
            obstacles[name] = new
        else:
            solid = shape(sample.kind, sample.size, name)
            if sample.kind == "sphere":  # has no orientation, and RViz does not require one
                sample = sample._replace(quaternion=UPRIGHT)
            pose_s = frames.pose_of(sample, "obstacle")
            put_into(obstacles, obstacle(name, solid, pose_s, stamped.time_ns, expires_ns=expires_ns))
        if frames.is_base(sample.frame_id):
            self._samples[name] = sample, obstacles[name]

    def update(
        self, q: Array, qd: Array, change: Array, hold_s: float, time_ns: int, repel: bool
    ) -> AvoidanceTerms | None:
        """Removes expired obstacles and computes the avoidance terms.

        Args:
            q: Joint positions, (n,), rad (m).
            qd: Present joint velocities, (n,), rad/s (m/s).
            change: Largest difference of the next velocities from ``qd``, (n,), rad/s (m/s).
            hold_s: Longest time for which a command is held, s.
            time_ns: Monotonic time, ns.
            repel: False for no repulsive potential.

        Returns:
            The terms, see :func:`ik_node.collision.avoidance.avoidance_terms`; None when :attr:`unavailable`.
        """
        if self._distances is None:
            return None
        self.scene = self.scene.at(time_ns)
        return avoidance_terms(self._distances, self.scene, q, qd, change, self._settings, hold_s, time_ns, repel)


_NO_SAMPLE: tuple[Any, None] = (None, None)


def _is_same(sample: ObstacleSample, other: ObstacleSample) -> bool:
    """True for the same solid at the same place."""
    return (
        sample.kind == other.kind
        and sample.size == other.size
        and sample.frame_id == other.frame_id
        and sample.position.tobytes() == other.position.tobytes()
        and (sample.kind == "sphere" or sample.quaternion.tobytes() == other.quaternion.tobytes())
    )


def _without(obstacles: dict[str, Obstacle], sample: ObstacleSample) -> dict[str, Obstacle]:
    """The obstacles after a deletion."""
    if sample.action == "delete_all":
        return dict(Scene(obstacles).remove_all(sample.name.rpartition("/")[0]).obstacles)
    if sample.action != "delete":
        raise InputError(f"unknown action '{sample.action}'; valid: add, delete, delete_all")
    obstacles.pop(sample.name, None)
    return obstacles

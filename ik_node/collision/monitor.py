"""What is around the arm: its own links and the obstacles, as one thing that the tick asks at every q."""

from __future__ import annotations

import hashlib

import numpy as np

from ik_node.collision import geometry as collision_geometry
from ik_node.collision.avoidance import Surroundings, look_around
from ik_node.collision.distances import Clearance, Closest
from ik_node.collision.scene import Scene, obstacle, read_scene, shape
from ik_node.errors import CollisionUnavailableError, InputError
from ik_node.interfaces.clock import Instant, place
from ik_node.interfaces.samples import ObstacleSample
from ik_node.math.types import Array
from ik_node.robot.frames import Frames
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ObstacleSettings


class Lookout:
    """Distances, dampers and the potential of one arm in a scene that may change."""

    def __init__(self, robot: Robot, settings: ObstacleSettings) -> None:
        """Builds the collision geometry; where that cannot be had, :attr:`unavailable` says why and the rest works.

        Raises SceneError when the scene's file cannot be used, and UnknownNameError for links that do not exist.
        """
        self._robot = robot
        self._settings = settings
        self._clearance: Clearance | None = None
        self.unavailable = ""
        """Why nothing is seen; empty when it is."""
        self.scene = Scene()
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
                self._clearance = Clearance(geometry)
            except CollisionUnavailableError as error:
                self.unavailable = str(error)
        if settings.scene:
            at_zero = np.zeros(robot.n)
            self.scene = read_scene(settings.scene, lambda frame: robot.frame_pose(at_zero, frame))

    @property
    def digest(self) -> str:
        """Tells the solids and the watched pairs from others; why nothing is seen, where that is so."""
        if self._clearance is None:
            return self.unavailable
        geometry = self._clearance.geometry
        digest = hashlib.sha256(repr(geometry.watched()).encode())
        for link in geometry.links:
            digest.update(f"{link.name} {type(link.solid).__name__}".encode())
            digest.update(link.points.tobytes() + link.placement.homogeneous.tobytes())
        return digest.hexdigest()[:16]

    @property
    def pairs(self) -> str:
        """Which pairs of links are watched, and why others are not, for a person; why none are, where that is so."""
        if self._clearance is None:
            return f"distances are not watched: {self.unavailable}"
        return collision_geometry.summary(self._clearance.geometry.pairs)

    def configure(self, settings: ObstacleSettings) -> None:
        """Other settings from now on; what is read-only stays as it was."""
        self._settings = settings

    def take(self, samples: tuple[ObstacleSample, ...], frames: Frames, now: Instant, max_age_ns: int) -> str:
        """Takes obstacles that arrive now; stamps older than ``max_age_ns`` are another clock's.

        Returns what is wrong with those that cannot be used, by name; the others count.
        """
        wrong = []
        for sample in samples:
            try:
                self._take(sample, frames, now, max_age_ns)
            except InputError as error:
                wrong.append(f"{sample.name}: {error}")
        return "; ".join(wrong)

    def _take(self, sample: ObstacleSample, frames: Frames, now: Instant, max_age_ns: int) -> None:
        if sample.action == "delete_all":
            self.scene = Scene()
        elif sample.action == "delete":
            self.scene = self.scene.remove(sample.name)
        elif sample.action == "add":
            stamped = place(sample.stamp_ns, now, max_age_ns)
            expires_ns = stamped.received_ns + sample.lifetime_ns if sample.lifetime_ns > 0 else None
            solid = shape(sample.kind, sample.size, sample.name)
            pose_s = frames.place(sample, "obstacle")
            self.scene = self.scene.put(obstacle(sample.name, solid, pose_s, stamped.time_ns, expires_ns=expires_ns))
        else:
            raise InputError(f"unknown action '{sample.action}'; valid: add, delete, delete_all")

    def look(self, q: Array, qd: Array, change: Array, hold_s: float, time_ns: int, repel: bool) -> Surroundings | None:
        """Potential, dampers and clearance; see :func:`ik_node.collision.avoidance.look_around`. None where blind."""
        if self._clearance is None:
            return None
        self.scene = self.scene.at(time_ns)
        return look_around(self._clearance, self.scene, q, qd, change, self._settings, hold_s, time_ns, repel)


__all__ = ["Closest", "Lookout", "Surroundings"]

"""Distances between the links, and between links and obstacles: exact where they matter, skipped where they cannot.

Every pair keeps a lower bound of its distance. A motion by dq lowers it by ``reach`` |dq| (and an obstacle's own motion
by that); only pairs whose bound falls below what is asked for are measured again. What is handed out is therefore exact
and does not depend on what was asked before: pairs within their range, and the closest of all.

The distance d of a pair grows along n, the unit vector from its first to its second solid, in penetration too (d < 0)::

    d(distance)/dq = n' (J_second - J_first)      J: of the nearest points, as if fixed to their links

Nearest points are unique for one strictly convex solid against a convex one. Between parallel faces they are not: the
gradient then belongs to one of the possible pairs of points, and n is right whichever it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ik_node.collision import Geometry, Link, add
from ik_node.scene import Obstacle, Scene, Shape
from ik_node.se3 import Array

TOLERANCE = 1e-9
"""GJK's, m2: curved solids (cylinders) come out to about 1e-9 m, flat and spherical ones to rounding. EPA's stays at
its 1e-6: tighter it fails in deep penetration."""


class Near(NamedTuple):
    """Pairs within the distance that was asked for, in a fixed order, k of them."""

    pair: tuple[int, ...]
    """Numbers of the pairs, for :meth:`Clearance.names`."""
    distance: Array
    """(k,), m; negative in penetration."""
    slope: Array
    """d(distance)/dq, (k, n), m per rad (m)."""
    drift: Array
    """What the obstacles' own motion does to the distances, (k,), m/s; negative towards the arm."""
    self_collision: Array
    """1 for pairs of links, 0 for obstacles, (k,)."""


class Closest(NamedTuple):
    """The smallest distance of all."""

    distance: float
    """m; inf where there is nothing to be near to."""
    names: tuple[str, ...]
    """Link, and link or obstacle; none where there is nothing to be near to."""
    points_s: Array
    """Nearest points on the first and on the second, in the base frame, (2, 3)."""


class Clearance:
    """Measures distances for one arm; keeps the lower bounds. Belongs to one thread."""

    def __init__(self, geometry: Geometry) -> None:
        """Without obstacles until :meth:`see` is called."""
        self.geometry = geometry
        robot = geometry.robot
        self._root_base = np.linalg.inv(robot.pose_base_root)
        self._names = geometry.names()
        # Every link inside a ball about a point of its joint's frame.
        self._centres = np.array([0.5 * (link.points.min(axis=0) + link.points.max(axis=0)) for link in geometry.links])
        self._radii = np.array(
            [_radius(link, centre) for link, centre in zip(geometry.links, self._centres, strict=True)]
        )
        self._parents = [link.parent for link in geometry.links]
        self._obstacles: tuple[Obstacle, ...] = ()
        self._ahead: Clearance | None = None
        self._q = np.zeros(robot.n)
        self._turns = bool(robot.continuous.any())
        self._scene, self._scene_moves = Scene(), False
        self._build(())

    def names(self, pair: int) -> tuple[str, str]:
        """Link, and link or obstacle, of a pair."""
        first, second = self._pairs[pair]
        count = len(self._names)
        return self._names[first], self._names[second] if second < count else self._obstacles[second - count].name

    def see(self, scene: Scene, time_ns: int) -> None:
        """Takes the obstacles as they are at a monotonic time; moving ones are carried on."""
        if scene is self._scene and not self._scene_moves:
            return
        self._scene = scene
        self._scene_moves = any(entry.moves for entry in scene.obstacles.values())
        seen = tuple(entry.at(time_ns) for entry in scene.obstacles.values())
        same = len(seen) == len(self._obstacles) and all(
            new.name == old.name and new.shape == old.shape for new, old in zip(seen, self._obstacles, strict=True)
        )
        if not same:
            self._build(seen)
            return
        for index, (new, old) in enumerate(zip(seen, self._obstacles, strict=True)):
            if new is not old and new.pose_s is not old.pose_s:
                self._move(index, new, old)
        self._obstacles = seen

    def _build(self, obstacles: tuple[Obstacle, ...]) -> None:
        geometry, count = self.geometry, len(self.geometry.links)
        self._model = pin.GeometryModel()
        for link in geometry.links:
            add(self._model, link.name, link.parent, link.solid, link.placement)
        for entry in obstacles:
            add(self._model, entry.name, 0, solid(entry.shape), self._root_placement(entry))
        moving = np.flatnonzero(geometry.moves.any(axis=1)).tolist()
        self._pairs = geometry.watched()
        self._own = len(self._pairs)
        self._pairs += [(link, count + index) for index in range(len(obstacles)) for link in moving]
        for first, second in self._pairs:
            self._model.addCollisionPair(pin.CollisionPair(first, second))
        self._data = pin.GeometryData(self._model)
        self._requests = list(self._data.distanceRequests)
        for request in self._requests:
            request.gjk_tolerance = TOLERANCE
        m, n = geometry.moves.shape[1], geometry.robot.n
        still = np.zeros((len(obstacles), m), dtype=bool)
        moves = np.concatenate((geometry.moves, still))
        reach = np.concatenate((geometry.reach, np.zeros((len(obstacles), n))))
        firsts, seconds = [pair[0] for pair in self._pairs], [pair[1] for pair in self._pairs]
        self._firsts, self._seconds = np.array(firsts, dtype=int), np.array(seconds, dtype=int)
        self._first_moves, self._second_moves = moves[firsts].astype(float), moves[seconds].astype(float)
        self._reach: Array = reach[firsts] + reach[seconds]
        self._bound = np.full(len(self._pairs), -np.inf)
        self._self = (np.arange(len(self._pairs)) < self._own).astype(float)
        self._obstacle_of = self._seconds - count
        self._obstacles = obstacles

    def _root_placement(self, entry: Obstacle) -> Any:
        return pin.SE3(self._root_base @ entry.pose_s)

    def _move(self, index: int, new: Obstacle, old: Obstacle) -> None:
        self._model.geometryObjects[len(self.geometry.links) + index].placement = self._root_placement(new)
        turned = float(np.linalg.norm(new.pose_s[:3, :3] - old.pose_s[:3, :3]))
        moved = float(np.linalg.norm(new.pose_s[:3, 3] - old.pose_s[:3, 3])) + turned * new.shape.reach
        self._bound[self._obstacle_of == index] -= moved

    @property
    def pairs(self) -> int:
        """How many pairs are watched."""
        return len(self._pairs)

    def speeds(self, q: Array, qd: Array, change: Array) -> Array:
        """(pairs,): how fast a distance can shrink at most at q (n,), at velocities within ``change`` of ``qd``, m/s.

        The links' speeds at ``qd``, each a ball that moves and turns, plus ``reach`` times the change.
        """
        moves = self.geometry.moves
        twists = (moves * self.geometry.robot.motion(qd)) @ self.geometry.robot.root_jacobian(q).T
        placements = self.geometry.robot.data.oMi
        centres = np.array(
            [placements[parent].act(at) for parent, at in zip(self._parents, self._centres, strict=True)]
        )
        spin = twists[:, 3:]
        at_centre = twists[:, :3] + _cross(spin, centres)
        fastest = np.sqrt((at_centre**2).sum(axis=1)) + np.sqrt((spin**2).sum(axis=1)) * self._radii
        of_obstacles = [
            float(np.linalg.norm(entry.velocity_s) + np.linalg.norm(entry.spin_s) * entry.shape.reach)
            if entry.moves
            else 0.0
            for entry in self._obstacles
        ]
        fastest = np.concatenate((fastest, of_obstacles))
        return np.asarray(fastest[self._firsts] + fastest[self._seconds] + self._reach @ change)

    def self_pairs(self) -> Array:
        """(pairs,): 1 for pairs of links, 0 for obstacles."""
        return self._self

    @property
    def ahead(self) -> Clearance:
        """Another measurer of the same arm, for places where it is going to be."""
        if self._ahead is None:
            self._ahead = Clearance(self.geometry)
        return self._ahead

    def measure(self, q: Array, within: Array) -> tuple[Near, Closest]:
        """Pairs nearer than ``within`` (pairs,), m, and the closest of all, at q (n,)."""
        if not self._pairs:
            return _nothing(self.geometry.robot.n), _NOWHERE
        jacobian, measured = self._begin(q, within)
        # The closest: whatever still might be nearer than the nearest found so far.
        while True:
            pair = int(np.argmin(self._bound))
            if pair in measured:
                break
            self._measure(pair, measured)
        near = [pair for pair in sorted(measured) if self._bound[pair] < within[pair]]
        return self._near(near, measured, jacobian), self._closest(pair, measured[pair])

    def near(self, q: Array, within: Array) -> Near:
        """As :meth:`measure`, without the closest."""
        if not self._pairs:
            return _nothing(self.geometry.robot.n)
        jacobian, measured = self._begin(q, within)
        return self._near([pair for pair in sorted(measured) if self._bound[pair] < within[pair]], measured, jacobian)

    def _begin(self, q: Array, within: Array) -> tuple[Array, dict[int, Any]]:
        """Lowers the bounds by the motion since the last call and measures what falls below ``within``."""
        robot = self.geometry.robot
        self._bound -= self._reach @ np.abs(robot.difference(self._q, q) if self._turns else q - self._q)
        self._q = q.copy()
        jacobian = robot.root_jacobian(q)
        pin.updateGeometryPlacements(robot.model, robot.data, self._model, self._data)
        measured: dict[int, Any] = {}
        for pair in np.flatnonzero(self._bound < within).tolist():
            self._measure(pair, measured)
        return jacobian, measured

    def _measure(self, pair: int, measured: dict[int, Any]) -> None:
        # Pinocchio starts from the last answer, which shows in the last digits (1e-6 m was seen): forget it.
        request = self._requests[pair]
        request.cached_gjk_guess, request.cached_support_func_guess = _FIRST_GUESS, _FIRST_CORNERS
        found = pin.computeDistance(self._model, self._data, pair)
        distance = found.min_distance
        normal, first, second = found.normal, found.getNearestPoint1(), found.getNearestPoint2()
        if not (abs(distance) < 1e6 and abs(float(normal @ normal) - 1.0) < 1e-3):
            # EPA can fail in deep penetration: in contact, direction by the centres.
            distance = 0.0
            poses = self._data.oMg
            first, second = poses[self._pairs[pair][0]].translation, poses[self._pairs[pair][1]].translation
            apart = second - first
            normal = apart / max(float(np.linalg.norm(apart)), 1e-9)
        self._bound[pair] = distance
        measured[pair] = (distance, normal, first, second)

    def _near(self, near: list[int], measured: dict[int, Any], jacobian: Array) -> Near:
        if not near:
            return _nothing(self.geometry.robot.n)
        distances, normals, firsts, seconds = (
            np.array(part) for part in zip(*(measured[p] for p in near), strict=True)
        )
        # A twist (v, w) moves a point p by v + w x p; along n: n.v + (p x n).w
        at_first = _rows(np.concatenate((normals, _cross(firsts, normals)), axis=1), jacobian)
        at_second = _rows(np.concatenate((normals, _cross(seconds, normals)), axis=1), jacobian)
        slope = self._second_moves[near] * at_second - self._first_moves[near] * at_first
        slope = self.geometry.robot.per_joint(slope)
        drift = np.zeros(len(near))
        for row, pair in enumerate(near):
            entry = self._obstacles[self._obstacle_of[pair]] if pair >= self._own else None
            if entry is not None and entry.moves:
                drift[row] = self._drift(entry, normals[row], seconds[row])
        return Near(tuple(near), distances, slope, drift, self._self[near])

    def _drift(self, entry: Obstacle, normal: Array, point: Array) -> float:
        root = self._root_base[:3, :3]
        lever = point - (self._root_base @ entry.pose_s)[:3, 3]
        return float(normal @ (root @ entry.velocity_s + np.cross(root @ entry.spin_s, lever)))

    def _closest(self, pair: int, found: tuple[float, Array, Array, Array]) -> Closest:
        pose = self.geometry.robot.pose_base_root
        points = np.stack((found[2], found[3])) @ pose[:3, :3].T + pose[:3, 3]
        return Closest(float(found[0]), self.names(pair), points)


def _radius(link: Link, centre: Array) -> float:
    """Of the ball about ``centre`` that holds the link; all points of a capsule lie within its radius of its axis."""
    farthest = float(np.sqrt(((link.points - centre) ** 2).sum(axis=1)).max())
    if isinstance(link.solid, coal.Capsule):
        middle = float(np.linalg.norm(link.placement.translation - centre))
        return max(farthest, middle + float(link.solid.halfLength + link.solid.radius))
    return farthest


def _cross(a: Array, b: Array) -> Array:
    """Row by row, (k, 3); numpy's own takes six times as long."""
    return np.asarray(a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT])


def _rows(wrenches: Array, jacobian: Array) -> Array:
    """``wrenches`` (k, 6) times ``jacobian``, in an order of summing that does not hang on k."""
    return np.asarray(np.add.reduce(wrenches[:, :, None] * jacobian, axis=1))


_FIRST_GUESS, _FIRST_CORNERS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


def _nothing(n: int) -> Near:
    return Near((), np.zeros(0), np.zeros((0, n)), np.zeros(0), np.zeros(0))


_NOWHERE = Closest(float("inf"), (), np.full((2, 3), np.nan))


def solid(wanted: Shape) -> Any:
    """The coal solid of a shape."""
    if wanted.kind == "sphere":
        return coal.Sphere(*wanted.size)
    if wanted.kind == "box":
        return coal.Box(*wanted.size)
    return (coal.Cylinder if wanted.kind == "cylinder" else coal.Capsule)(*wanted.size)

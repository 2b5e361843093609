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

from ik_node.collision.distance_kernels import (
    NONE_NEAR,
    Indices,
    Near,
    closest_pair,
    fastest_approach,
    list_near,
    lower_bounds,
    lower_bounds_of,
    note_motion,
    take_measurement,
)
from ik_node.collision.geometry import Geometry, Link, add
from ik_node.collision.scene import Obstacle, Scene, Shape
from ik_node.math.types import Array

Motions = tuple[Array, Array, Array, Array, Array, Array, Array, Indices, Indices, Array]

TOLERANCE = 1e-9
"""GJK's, m2: curved solids (cylinders) come out to about 1e-9 m, flat and spherical ones to rounding. EPA's stays at
its 1e-6: tighter it fails in deep penetration."""


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
        self._base_root = np.ascontiguousarray(robot.pose_base_root)
        self._root_base: Array = np.ascontiguousarray(np.linalg.inv(robot.pose_base_root))
        self._names = geometry.names()
        self._link_moves = geometry.moves.astype(float)
        self._ratio = np.ascontiguousarray(np.column_stack([robot.motion(alone) for alone in np.eye(robot.n)]))
        # Every link inside a ball about a point of its joint's frame.
        self._centres = [0.5 * (link.points.min(axis=0) + link.points.max(axis=0)) for link in geometry.links]
        self._radii = np.array(
            [_radius(link, centre) for link, centre in zip(geometry.links, self._centres, strict=True)]
        )
        self._ahead: Clearance | None = None
        self._q = np.zeros(robot.n)
        self._turns = bool(robot.continuous.any())
        self._scene = Scene()
        self._entries: tuple[Obstacle, ...] = ()
        self._moving: list[int] = []
        self._build([])

    def names(self, pair: int) -> tuple[str, str]:
        """Link, and link or obstacle, of a pair."""
        return self._pair_names[pair]

    def see(self, scene: Scene, time_ns: int) -> None:
        """Takes the obstacles as they are at a monotonic time; moving ones are carried on."""
        entries = self._entries
        if scene is self._scene:
            for index in self._moving:
                self._move(index, entries[index].at(time_ns))
            return
        self._scene, self._entries = scene, tuple(scene.obstacles.values())
        self._moving = [index for index, entry in enumerate(self._entries) if entry.moves]
        seen = [entry.at(time_ns) for entry in self._entries]
        same = len(seen) == len(self._obstacles) and all(
            new.name == old.name and new.shape == old.shape for new, old in zip(seen, self._obstacles, strict=True)
        )
        if not same:
            self._build(seen)
            return
        for index, new in enumerate(seen):
            self._move(index, new)

    def _build(self, obstacles: list[Obstacle]) -> None:
        geometry, count = self.geometry, len(self.geometry.links)
        moving = np.flatnonzero(geometry.moves.any(axis=1)).tolist()
        own = geometry.watched()
        pairs = own + [(link, count + index) for index in range(len(obstacles)) for link in moving]
        self._build_model(obstacles, pairs)
        n, k = geometry.robot.n, len(pairs)
        self._moves = np.concatenate((self._link_moves, np.zeros((len(obstacles), self._link_moves.shape[1]))))
        reach = np.concatenate((geometry.reach, np.zeros((len(obstacles), n))))
        self._firsts, self._seconds = np.array(pairs, dtype=np.int64).reshape(-1, 2).T.copy()
        self._reach = reach[self._firsts] + reach[self._seconds]
        self._self = (np.arange(k) < len(own)).astype(float)
        self._bound, self._fresh = np.full(k, -np.inf), np.zeros(k, dtype=np.bool_)
        self._normals, self._points = np.zeros((k, 3)), np.zeros((k, 2, 3))
        self.rows = Near(np.zeros(k, dtype=np.int64), np.zeros(k), np.zeros((k, n)), np.zeros(k), np.zeros(k))
        """Room for all pairs; what the last :meth:`survey` found stands in the first rows."""
        names = (*self._names, *(entry.name for entry in obstacles))
        self._pair_names = [(names[first], names[second]) for first, second in pairs]
        self._obstacles = obstacles
        self._speeds, self._motions = np.zeros(len(obstacles)), np.zeros((len(obstacles), 3, 3))
        for index, entry in enumerate(obstacles):
            self._note_motion(index, entry, entry)

    def _build_model(self, obstacles: list[Obstacle], pairs: list[tuple[int, int]]) -> None:
        """Links, obstacles and the balls around the links for Pinocchio to place."""
        links = self.geometry.links
        self._model = pin.GeometryModel()
        for link in links:
            add(self._model, link.name, link.parent, link.solid, link.placement)
        for entry in obstacles:
            add(self._model, entry.name, 0, solid(entry.shape), self._root_placement(entry))
        for link, centre, radius in zip(links, self._centres, self._radii.tolist(), strict=True):
            add(self._model, f"ball {link.name}", link.parent, coal.Sphere(radius), pin.SE3(np.eye(3), centre))
        for first, second in pairs:
            self._model.addCollisionPair(pin.CollisionPair(first, second))
        self._data = pin.GeometryData(self._model)
        self._requests = list(self._data.distanceRequests)
        for request in self._requests:
            request.gjk_tolerance = TOLERANCE
        self._origins = _origins(self._data)
        self._ball_centres = self._origins[len(links) + len(obstacles) :]
        self._placed_at = b""

    def _root_placement(self, entry: Obstacle) -> Any:
        return pin.SE3(self._root_base @ entry.pose_s)

    def _move(self, index: int, new: Obstacle) -> None:
        old = self._obstacles[index]
        if new is old:
            return
        moved = self._note_motion(index, new, old)
        self._obstacles[index] = new
        if moved != 0.0:
            number = len(self._radii) + index
            self._model.geometryObjects[number].placement = self._root_placement(new)
            lower_bounds_of(number, moved, self._seconds, self._bound)
            self._placed_at = b""

    def _note_motion(self, index: int, new: Obstacle, old: Obstacle) -> float:
        """Notes velocities and place of an obstacle; by how much it has moved since ``old``, m."""
        return note_motion(
            new.pose_s,
            old.pose_s,
            new.velocity_s,
            new.spin_s,
            new.shape.reach,
            self._root_base,
            index,
            self._speeds,
            self._motions,
        )

    @property
    def pairs(self) -> int:
        """How many pairs are watched."""
        return len(self._bound)

    def speeds(self, q: Array, qd: Array, change: Array) -> Array:
        """(pairs,): how fast a distance can shrink at most at q (n,), at velocities within ``change`` of ``qd``, m/s.

        The links' speeds at ``qd``, each a ball that moves and turns, plus ``reach`` times the change.
        """
        return fastest_approach(*self.motions(q, qd, change))

    def motions(self, q: Array, qd: Array, change: Array) -> Motions:
        """What :func:`ik_node.collision.distance_kernels.fastest_approach` takes, for other compiled functions to hand on."""
        return (
            self.geometry.robot.motion(qd),
            change,
            self._place(q),
            self._link_moves,
            self._ball_centres,
            self._radii,
            self._speeds,
            self._firsts,
            self._seconds,
            self._reach,
        )

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
        count = self.survey(q, within)
        return Near(*(part[:count].copy() for part in self.rows)), self.closest()

    def survey(self, q: Array, within: Array, closest: bool = True) -> int:
        """How many pairs are nearer than ``within`` (pairs,), m, at q (n,); they stand in the first :attr:`rows`.

        ``closest``: False where :meth:`closest` is not going to be asked for.
        """
        if not self.pairs:
            return 0
        motion = self.geometry.robot.difference(self._q, q) if self._turns else q - self._q
        self._q = q.copy()
        jacobian = self._place(q)
        pair = lower_bounds(motion, self._reach, self._bound, self._fresh, within, closest)
        while pair >= 0:
            pair = self._measure(pair, within, closest)
        if pair == NONE_NEAR:
            return 0
        return list_near(
            within,
            jacobian,
            self._ratio,
            self._moves,
            self._motions,
            self._firsts,
            self._seconds,
            self._bound,
            self._fresh,
            self._normals,
            self._points,
            *self.rows,
        )

    def closest(self) -> Closest:
        """The closest pair of the last :meth:`survey`."""
        if not self.pairs:
            return _NOWHERE
        pair, distance, points_s = closest_pair(self._bound, self._points, self._base_root)
        return Closest(distance, self._pair_names[pair], points_s)

    def _place(self, q: Array) -> Array:
        """Puts the solids where they are at q (n,); (m, 6): the twists that the moving joints give, from the root."""
        if (at := q.tobytes()) != self._placed_at:
            robot = self.geometry.robot
            jacobian = robot.root_jacobian(q)
            pin.updateGeometryPlacements(robot.model, robot.data, self._model, self._data)
            self._jacobian, self._placed_at = np.ascontiguousarray(jacobian.T), at
        return self._jacobian

    def _measure(self, pair: int, within: Array, closest: bool) -> int:
        """Measures a pair; the next one to measure, see :func:`ik_node.collision.distance_kernels.next_pair`."""
        # Pinocchio starts from the last answer, which shows in the last digits (1e-6 m was seen): forget it.
        request = self._requests[pair]
        request.cached_gjk_guess, request.cached_support_func_guess = _FIRST_GUESS, _FIRST_CORNERS
        found = pin.computeDistance(self._model, self._data, pair)
        return take_measurement(
            pair,
            found.min_distance,
            found.normal,
            found.getNearestPoint1(),
            found.getNearestPoint2(),
            self._origins,
            self._firsts,
            self._seconds,
            self._bound,
            self._fresh,
            self._normals,
            self._points,
            within,
            closest,
        )


def _origins(data: Any) -> Array:
    """(solids, 3): where the solids' own frames are, seen from the root, m; follows every update of the placements.

    A view of Pinocchio's memory, where they lie at even steps: to take them out one by one is slower than all else that
    is done with distances in a tick. RuntimeError where they do not lie like that.
    """
    views = [placement.translation for placement in data.oMg]
    places = [view.__array_interface__["data"][0] for view in views]
    step = places[1] - places[0]
    even = places == [places[0] + step * index for index in range(len(places))]
    if not even or any(view.flags.owndata for view in views):
        raise RuntimeError("Pinocchio keeps placements in another way than this was written for")
    return np.lib.stride_tricks.as_strided(views[0], (len(views), 3), (step, views[0].strides[0]), writeable=False)


def _radius(link: Link, centre: Array) -> float:
    """Of the ball about ``centre`` that holds the link; all points of a capsule lie within its radius of its axis."""
    farthest = float(np.sqrt(((link.points - centre) ** 2).sum(axis=1)).max())
    if isinstance(link.solid, coal.Capsule):
        middle = float(np.linalg.norm(link.placement.translation - centre))
        return max(farthest, middle + float(link.solid.halfLength + link.solid.radius))
    return farthest


_FIRST_GUESS, _FIRST_CORNERS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
_NOWHERE = Closest(float("inf"), (), np.full((2, 3), np.nan))


def solid(wanted: Shape) -> Any:
    """The coal solid of a shape."""
    if wanted.kind == "sphere":
        return coal.Sphere(*wanted.size)
    if wanted.kind == "box":
        return coal.Box(*wanted.size)
    return (coal.Cylinder if wanted.kind == "cylinder" else coal.Capsule)(*wanted.size)


__all__ = ["Clearance", "Closest", "Near", "solid"]

"""Distances between links, and between links and obstacles.

Each pair keeps a lower bound of its distance. A joint motion dq decreases the bound by ``reach`` |dq|, and the motion
of an obstacle decreases it by the distance travelled. Only pairs whose bound is below the requested range are computed
again. The results (all pairs within their range, and the closest pair) are exact and do not depend on earlier queries.

The distance d of a pair increases along n, the unit vector from its first to its second solid, also in penetration
(d < 0)::

    d(distance)/dq = n' (J_second - J_first)      J: point Jacobians of the nearest points, fixed to their links

The nearest points are unique when one of two convex solids is strictly convex. Between parallel faces they are not
unique; the gradient then belongs to one of the possible pairs of points, and n is the same for all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from ik_node.collision.distance_kernels import (
    NO_PAIR_NEAR,
    Indices,
    NearPairs,
    closest_pair,
    collect_near_pairs,
    decrease_bounds,
    decrease_bounds_of_solid,
    store_measurement,
    store_obstacle_motion,
)
from ik_node.collision.geometry import CollisionGeometry
from ik_node.collision.pair_selection import Link, add
from ik_node.collision.scene import Obstacle, Scene, Shape
from ik_node.math.types import Array

Motions = tuple[Array, Array, Array, Array, Array, Array, Array, Indices, Indices, Array]

TOLERANCE = 1e-9
"""Tolerance of GJK, m2. Distances of cylinders are then accurate to about 1e-9 m, those of flat solids and spheres to
rounding. The tolerance of EPA stays at its default of 1e-6: EPA fails in deep penetration with a smaller one."""


class ClosestPair(NamedTuple):
    """The pair with the smallest distance."""

    distance: float
    """m; inf when there are no pairs."""
    names: tuple[str, ...]
    """Names of the link and of the other link or obstacle; empty when there are no pairs."""
    points_s: Array
    """Nearest points on the first and on the second solid, in the base frame, (2, 3), m."""


class DistanceQuery:
    """Computes the distances of one arm and keeps their lower bounds. Not thread-safe."""

    def __init__(self, geometry: CollisionGeometry) -> None:
        """Starts without obstacles; see :meth:`set_scene`."""
        self.geometry = geometry
        robot = geometry.robot
        self._base_root = np.ascontiguousarray(robot.pose_base_root)
        self._root_base: Array = np.ascontiguousarray(np.linalg.inv(robot.pose_base_root))
        self._names = geometry.names()
        self._link_moves = geometry.moves.astype(float)
        self._ratio = np.ascontiguousarray(np.column_stack([robot.motion(alone) for alone in np.eye(robot.n)]))
        # Bounding sphere of each link, centred at a point fixed in the frame of its joint.
        self._centres = [0.5 * (link.points.min(axis=0) + link.points.max(axis=0)) for link in geometry.links]
        self._radii = np.array(
            [_radius(link, centre) for link, centre in zip(geometry.links, self._centres, strict=True)]
        )
        self._predicted: DistanceQuery | None = None
        self._q = np.zeros(robot.n)
        self._turns = bool(robot.continuous.any())
        self._scene = Scene()
        self._entries: tuple[Obstacle, ...] = ()
        self._moving: list[int] = []
        self._build([])

    def names(self, pair: int) -> tuple[str, str]:
        """Names of the link and of the other link or obstacle of a pair."""
        return self._pair_names[pair]

    def set_scene(self, scene: Scene, time_ns: int) -> None:
        """Sets the obstacles, and extrapolates moving ones to a monotonic time.

        Args:
            scene: The obstacles.
            time_ns: Monotonic time at which the distances are queried, ns.
        """
        entries = self._entries
        if scene is self._scene:
            for index in self._moving:
                self._move(index, entries[index].at(time_ns))
            return
        self._scene, self._entries = scene, tuple(scene.obstacles.values())
        self._moving = [index for index, entry in enumerate(self._entries) if entry.moves]
        current = [entry.at(time_ns) for entry in self._entries]
        same = len(current) == len(self._obstacles) and all(
            new.name == old.name and new.shape == old.shape for new, old in zip(current, self._obstacles, strict=True)
        )
        if not same:
            self._build(current)
            return
        for index, new in enumerate(current):
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
        self.rows = NearPairs(np.zeros(k, dtype=np.int64), np.zeros(k), np.zeros((k, n)), np.zeros(k), np.zeros(k))
        """Buffer for all pairs; its first rows hold the result of the last :meth:`query`."""
        names = (*self._names, *(entry.name for entry in obstacles))
        self._pair_names = [(names[first], names[second]) for first, second in pairs]
        self._obstacles = obstacles
        self._speeds, self._motions = np.zeros(len(obstacles)), np.zeros((len(obstacles), 3, 3))
        for index, entry in enumerate(obstacles):
            self._store_motion(index, entry, entry)

    def _build_model(self, obstacles: list[Obstacle], pairs: list[tuple[int, int]]) -> None:
        """Builds Pinocchio's model of the links, the obstacles and the links' bounding spheres."""
        links = self.geometry.links
        self._model = pin.GeometryModel()
        for link in links:
            add(self._model, link.name, link.parent, link.solid, link.placement)
        for entry in obstacles:
            add(self._model, entry.name, 0, solid(entry.shape), self._root_placement(entry))
        for link, centre, radius in zip(links, self._centres, self._radii.tolist(), strict=True):
            add(self._model, f"sphere {link.name}", link.parent, coal.Sphere(radius), pin.SE3(np.eye(3), centre))
        for first, second in pairs:
            self._model.addCollisionPair(pin.CollisionPair(first, second))
        self._data = pin.GeometryData(self._model)
        self._requests = list(self._data.distanceRequests)
        for request in self._requests:
            request.gjk_tolerance = TOLERANCE
        self._origins = _origins(self._data)
        self._sphere_centres = self._origins[len(links) + len(obstacles) :]
        self._placed_at = b""

    def _root_placement(self, entry: Obstacle) -> Any:
        return pin.SE3(self._root_base @ entry.pose_s)

    def _move(self, index: int, new: Obstacle) -> None:
        old = self._obstacles[index]
        if new is old:
            return
        moved = self._store_motion(index, new, old)
        self._obstacles[index] = new
        if moved != 0.0:
            number = len(self._radii) + index
            self._model.geometryObjects[number].placement = self._root_placement(new)
            decrease_bounds_of_solid(number, moved, self._seconds, self._bound)
            self._placed_at = b""

    def _store_motion(self, index: int, new: Obstacle, old: Obstacle) -> float:
        """Stores velocity and position of an obstacle; returns the distance it has moved since ``old``, m."""
        return store_obstacle_motion(
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
        """Number of pairs."""
        return len(self._bound)

    def motions(self, q: Array, qd: Array, change: Array) -> Motions:
        """Arguments of :func:`ik_node.collision.distance_kernels.approach_speed_bounds`.

        Args:
            q: Joint positions, (n,), rad (m).
            qd: Joint velocities, (n,), rad/s (m/s).
            change: Largest difference of the velocities from ``qd``, (n,), rad/s (m/s).
        """
        return (
            self.geometry.robot.motion(qd),
            change,
            self._place(q),
            self._link_moves,
            self._sphere_centres,
            self._radii,
            self._speeds,
            self._firsts,
            self._seconds,
            self._reach,
        )

    def self_pairs(self) -> Array:
        """(pairs,): 1 for pairs of links, 0 for pairs of link and obstacle."""
        return self._self

    @property
    def predicted(self) -> DistanceQuery:
        """A second query for the same arm, for distances at a predicted position."""
        if self._predicted is None:
            self._predicted = DistanceQuery(self.geometry)
        return self._predicted

    def measure(self, q: Array, within: Array) -> tuple[NearPairs, ClosestPair]:
        """Computes the pairs within a range, and the closest pair.

        Args:
            q: Joint positions, (n,), rad (m).
            within: Range of each pair, (pairs,), m.

        Returns:
            The pairs nearer than their range, and the closest of all pairs.
        """
        count = self.query(q, within)
        return NearPairs(*(column[:count].copy() for column in self.rows)), self.closest()

    def query(self, q: Array, within: Array, closest: bool = True) -> int:
        """Computes the pairs within a range and writes them into the first rows of :attr:`rows`.

        Args:
            q: Joint positions, (n,), rad (m).
            within: Range of each pair, (pairs,), m.
            closest: False when :meth:`closest` is not called for this position.

        Returns:
            The number of pairs nearer than their range.
        """
        if not self.pairs:
            return 0
        motion = self.geometry.robot.difference(self._q, q) if self._turns else q - self._q
        self._q = q.copy()
        jacobian = self._place(q)
        pair = decrease_bounds(motion, self._reach, self._bound, self._fresh, within, closest)
        while pair >= 0:
            pair = self._measure(pair, within, closest)
        if pair == NO_PAIR_NEAR:
            return 0
        return collect_near_pairs(
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

    def closest(self) -> ClosestPair:
        """The closest pair of the last :meth:`query`."""
        if not self.pairs:
            return _NO_PAIR
        pair, distance, points_s = closest_pair(self._bound, self._points, self._base_root)
        return ClosestPair(distance, self._pair_names[pair], points_s)

    def _place(self, q: Array) -> Array:
        """Updates the placements of the solids at q (n,); returns the joint twists in the root frame, (m, 6)."""
        if (at := q.tobytes()) != self._placed_at:
            robot = self.geometry.robot
            jacobian = robot.root_jacobian(q)
            pin.updateGeometryPlacements(robot.model, robot.data, self._model, self._data)
            self._jacobian, self._placed_at = np.ascontiguousarray(jacobian.T), at
        return self._jacobian

    def _measure(self, pair: int, within: Array, closest: bool) -> int:
        """Computes the distance of a pair; returns the next one, see :func:`.distance_kernels.next_pair`."""
        # Pinocchio warm-starts from the last result, which changes the last digits (up to 1e-6 m): reset the guesses.
        request = self._requests[pair]
        request.cached_gjk_guess, request.cached_support_func_guess = _FIRST_GUESS, _FIRST_CORNERS
        result = pin.computeDistance(self._model, self._data, pair)
        return store_measurement(
            pair,
            result.min_distance,
            result.normal,
            result.getNearestPoint1(),
            result.getNearestPoint2(),
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
    """(solids, 3): origins of the solids in the root frame, m; updated in place with the placements.

    The result is a strided view of Pinocchio's memory, because copying the origins one by one takes longer than the
    other distance computations of a control step. Raises RuntimeError when the memory layout is not strided.
    """
    views = [placement.translation for placement in data.oMg]
    places = [view.__array_interface__["data"][0] for view in views]
    step = places[1] - places[0]
    even = places == [places[0] + step * index for index in range(len(places))]
    if not even or any(view.flags.owndata for view in views):
        raise RuntimeError("unsupported memory layout of pinocchio.GeometryData.oMg")
    return np.lib.stride_tricks.as_strided(views[0], (len(views), 3), (step, views[0].strides[0]), writeable=False)


def _radius(link: Link, centre: Array) -> float:
    """Radius of a sphere about ``centre`` that contains the link, m."""
    farthest = float(np.sqrt(((link.points - centre) ** 2).sum(axis=1)).max())
    if isinstance(link.solid, coal.Capsule):
        middle = float(np.linalg.norm(link.placement.translation - centre))
        return max(farthest, middle + float(link.solid.halfLength + link.solid.radius))
    return farthest


_FIRST_GUESS, _FIRST_CORNERS = np.array([1.0, 0.0, 0.0]), np.zeros(2, dtype=np.int32)
_NO_PAIR = ClosestPair(float("inf"), (), np.full((2, 3), np.nan))


def solid(shape: Shape) -> Any:
    """The coal solid of a shape."""
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    if shape.kind == "box":
        return coal.Box(*shape.size)
    return (coal.Cylinder if shape.kind == "cylinder" else coal.Capsule)(*shape.size)

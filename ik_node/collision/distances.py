"""Distances between links, and between links and obstacles.

Each pair keeps a lower bound of its distance: that of the capsules around its solids, or its last computed distance
less the motion of both solids since then (:mod:`.distance_bounds`). Only pairs whose bound is below the requested
range are computed, by coal (:mod:`.convex_distances`). The results (all pairs within their range, and the closest pair)
are exact and do not depend on earlier queries.

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

from ik_node.collision.convex_distances import ConvexDistances
from ik_node.collision.distance_bounds import MARGIN_M, Limits, find_near_pairs
from ik_node.collision.distance_kernels import NearPairs, collect_near_pairs, in_base, store_distances
from ik_node.collision.geometry import CollisionGeometry
from ik_node.collision.obstacle_arrays import ObstacleArrays, obstacle_arrays, place_obstacles
from ik_node.collision.pair_selection import add
from ik_node.collision.scene import EXTRAPOLATION_S, MAX_GAP_S, Scene
from ik_node.math.types import Array


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
        robot, count = geometry.robot, len(geometry.links)
        self._base_root = np.ascontiguousarray(robot.pose_base_root)
        self._base_is_root = bool((robot.pose_base_root == np.eye(4)).all())
        self._root_base: Array = np.ascontiguousarray(np.linalg.inv(robot.pose_base_root))
        self._names = geometry.names()
        self._moves = geometry.moves.astype(float)
        self._ratio = np.ascontiguousarray(np.column_stack([robot.motion(alone) for alone in np.eye(robot.n)]))
        self._still = np.zeros(robot.n)
        self._q = np.zeros(robot.n)
        self._turns = bool(robot.continuous.any())
        self._own = geometry.watched()
        self._firsts, self._seconds = np.array(self._own, dtype=np.int64).reshape(-1, 2).T.copy()
        self._links = np.flatnonzero(geometry.moves.any(axis=1))
        self._model = pin.GeometryModel()
        for link in geometry.links:
            add(self._model, link.name, link.parent, link.solid, link.placement)
        self._data = pin.GeometryData(self._model)
        self._places = _places(self._data)
        self._placed_at = b""
        self._capsules, self._travel = np.zeros((count, 7)), np.zeros(count + 1)
        self._distances = ConvexDistances([link.solid for link in geometry.links])
        self._transforms: list[Any] = [coal.Transform3s() for _ in geometry.links]
        """Of links, then of obstacles; None for an obstacle that has moved."""
        self._parts = [(place[:9].reshape(3, 3).T, place[9:]) for place in self._places]
        self._transformed = [0] * count
        self._tick = 0
        self._predicted: DistanceQuery | None = None
        self._scene = Scene()
        self._time_ns = 0
        self.arrays: ObstacleArrays
        """The obstacles."""
        self._build(obstacle_arrays(self._scene))

    def names(self, pair: int) -> tuple[str, str]:
        """Names of the link and of the other link or obstacle of a pair."""
        if pair < len(self._own):
            first, second = self._own[pair]
            return self._names[first], self._names[second]
        obstacle, place = divmod(int(pair) - len(self._own), len(self._links))
        return self._names[self._links[place]], self.arrays.names[obstacle]

    def set_scene(self, scene: Scene, time_ns: int, arrays: ObstacleArrays | None = None) -> None:
        """Sets the obstacles, and extrapolates moving ones to a monotonic time.

        Args:
            scene: The obstacles.
            time_ns: Monotonic time at which the distances are queried, ns.
            arrays: :attr:`arrays` of another query with this scene.
        """
        if scene is self._scene:
            if len(self.arrays.moving) and time_ns != self._time_ns:
                self._place_obstacles(self.arrays.moving, time_ns)
            return
        arrays = obstacle_arrays(scene) if arrays is None else arrays
        if arrays.names == self.arrays.names and arrays.shapes == self.arrays.shapes:
            self.arrays = arrays
        else:
            self._build(arrays)
        self._scene = scene
        self._place_obstacles(np.arange(len(arrays.names)), time_ns)

    def _build(self, arrays: ObstacleArrays) -> None:
        """Makes the arrays for another number of obstacles, without bounds."""
        count, n = len(arrays.names), self.geometry.robot.n
        pairs = len(self._own) + count * len(self._links)
        self.arrays = arrays
        self._programs: dict[int, Any] = {}
        self._transforms = self._transforms[: len(self._transformed)] + [None] * count
        self._obstacle_places, self._obstacle_capsules = np.zeros((count, 12)), np.zeros((count, 7))
        self._speeds, self._motions, self._obstacle_travel = np.zeros(count), np.zeros((count, 3, 3)), np.zeros(count)
        self._key, self._level = np.full(pairs, -np.inf), np.full(count, -np.inf)
        self._computed, self._closed = np.zeros(pairs, dtype=np.int64), np.zeros(count, dtype=np.int64)
        self._listed, self._within = np.empty((pairs, 3), dtype=np.int64), np.empty(pairs)
        self._distance, self._normals, self._points = np.empty(pairs), np.empty((pairs, 3)), np.empty((pairs, 2, 3))
        self.rows = NearPairs(
            np.empty(pairs, dtype=np.int64), np.empty(pairs), np.empty((pairs, n)), np.empty(pairs), np.empty(pairs)
        )
        """Buffer for all pairs; its first rows hold the result of the last :meth:`query`."""
        self._fastest, self._likely = 0.0, -np.inf

    def _place_obstacles(self, indices: Any, time_ns: int) -> None:
        arrays = self.arrays
        moved = place_obstacles(
            indices,
            time_ns,
            EXTRAPOLATION_S,
            MAX_GAP_S,
            arrays.poses,
            arrays.velocities,
            arrays.spins,
            arrays.times_ns,
            arrays.steady,
            arrays.reach,
            arrays.axes,
            self._root_base,
            self._obstacle_places,
            self._obstacle_capsules,
            self._speeds,
            self._motions,
            self._obstacle_travel,
        )
        self._time_ns = time_ns
        self._fastest = float(self._speeds.max(initial=0.0))
        for obstacle in moved.tolist():
            self._transforms[len(self._transformed) + obstacle] = None

    @property
    def pairs(self) -> int:
        """Number of pairs."""
        return len(self._key)

    @property
    def predicted(self) -> DistanceQuery:
        """A second query for the same arm, for distances at a predicted position."""
        if self._predicted is None:
            self._predicted = DistanceQuery(self.geometry)
        return self._predicted

    def measure(self, q: Array, within: float) -> tuple[NearPairs, ClosestPair]:
        """Computes the pairs within a range, and the closest pair.

        Args:
            q: Joint positions, (n,), rad (m).
            within: Range, m.

        Returns:
            The pairs nearer than the range, and the closest of all pairs.
        """
        count = self.query(q, Limits(within, within), self._still, self._still)
        return NearPairs(*(column[:count].copy() for column in self.rows)), self.closest()

    def query(self, q: Array, limits: Limits, qd: Array, change: Array, closest: bool = True) -> int:
        """Computes the pairs within their limits and writes them into the first rows of :attr:`rows`.

        Args:
            q: Joint positions, (n,), rad (m).
            limits: Distances within which pairs matter.
            qd: Joint velocities, (n,), rad/s (m/s).
            change: Largest difference of the next velocities from ``qd``, (n,), rad/s (m/s).
            closest: False when :meth:`closest` is not called for this position.

        Returns:
            The number of pairs nearer than their limit.
        """
        if not self.pairs:
            return 0
        robot = self.geometry.robot
        step = robot.difference(self._q, q) if self._turns else q - self._q
        self._q = q.copy()
        jacobian = self._place(q)
        self._tick += 1
        count, total = find_near_pairs(
            step,
            robot.motion(qd),
            change,
            jacobian,
            self._moves,
            self.geometry.reach,
            self._places,
            self.geometry.capsules,
            self._capsules,
            self._firsts,
            self._seconds,
            self._links,
            self._obstacle_capsules,
            self._speeds,
            self._fastest,
            self._travel,
            self._obstacle_travel,
            self._key,
            self._level,
            limits,
            self._likely if closest else -np.inf,
            self._listed,
            self._within,
            self._distance,
            self._normals,
            self._points,
        )
        end = total
        if count or closest:
            rows = self._compute(0, count, count, total, closest)
            while rows > end:
                end, rows = rows, self._compute(end, rows, count, total, closest)
        if closest:
            self._likely = float(self._distance[self._closest]) + MARGIN_M
        if not total:
            return 0
        return collect_near_pairs(
            total,
            self._listed,
            self._within,
            jacobian,
            self._ratio,
            self._moves,
            self._motions,
            self._distance,
            self._normals,
            self._points,
            *self.rows,
        )

    def closest(self) -> ClosestPair:
        """The closest pair of the last :meth:`query`."""
        if not self.pairs:
            return _NO_PAIR
        row = self._closest
        points_s = self._points[row].copy()
        if not self._base_is_root:
            points_s = in_base(points_s, self._base_root)
        return ClosestPair(float(self._distance[row]), self.names(int(self._listed[row, 0])), points_s)

    def _place(self, q: Array) -> Array:
        """Updates the placements of the links at q (n,); returns the joint twists in the root frame, (m, 6)."""
        if (at := q.tobytes()) != self._placed_at:
            robot = self.geometry.robot
            jacobian = robot.root_jacobian(q)
            pin.updateGeometryPlacements(robot.model, robot.data, self._model, self._data)
            self._jacobian, self._placed_at = np.ascontiguousarray(jacobian.T), at
        return self._jacobian

    def _compute(self, begin: int, end: int, count: int, total: int, closest: bool) -> int:
        """Computes the distances of the listed pairs ``begin`` to ``end``; with ``closest``, lists a further pair that
        may be the closest. Returns the number of listed pairs. ``count``, ``total``: see :func:`find_near_pairs`."""
        transforms, transformed, programs, tick = self._transforms, self._transformed, self._programs, self._tick
        links = len(transformed)
        triples = self._listed[begin:end].tolist()
        memory = self._distances.rows(begin, end)
        for (request, result), (pair, first, second) in zip(memory, triples, strict=True):
            if transformed[first] != tick:
                transforms[first].setTransform(*self._parts[first])
                transformed[first] = tick
            other = transforms[second]
            if second < links:
                if transformed[second] != tick:
                    other.setTransform(*self._parts[second])
                    transformed[second] = tick
            elif other is None:
                place = self._obstacle_places[second - links]
                other = transforms[second] = coal.Transform3s(place[:9].reshape(3, 3).T, place[9:])
            program = programs.get(pair)
            if program is None:
                shape = self.arrays.shapes[second - links] if second >= links else None
                program = programs[pair] = self._distances.program(first, second, shape)
            program(transforms[first], other, request, result)
        listed, self._closest = store_distances(
            begin,
            end,
            self._distances.results,
            self._distances.guesses,
            self._listed,
            self._places,
            self._obstacle_places,
            self._travel,
            self._obstacle_travel,
            self._key,
            tick,
            self._computed,
            self._distance,
            self._normals,
            self._points,
            count,
            total,
            closest,
            self._capsules,
            self._firsts,
            self._seconds,
            self._links,
            self._obstacle_capsules,
            self._level,
            self._closed,
        )
        return listed


def _places(data: Any) -> Array:
    """(links, 12): rotations by columns and origins of the links; updated in place with the placements.

    The result is a view of Pinocchio's memory, because copying the placements one by one takes longer than the other
    distance computations of a control step. Raises RuntimeError when the memory is not laid out as expected.
    """
    count = len(data.oMg)
    rotations, origins = [entry.rotation for entry in data.oMg], [entry.translation for entry in data.oMg]
    first = rotations[0].__array_interface__["data"][0]
    even = all(
        rotation.__array_interface__["data"][0] == first + 96 * index
        and rotation.strides == (8, 24)
        and origin.__array_interface__["data"][0] == first + 96 * index + 72
        for index, (rotation, origin) in enumerate(zip(rotations, origins, strict=True))
    )
    if not even or any(view.flags.owndata for view in rotations + origins):
        raise RuntimeError("unsupported memory layout of pinocchio.GeometryData.oMg")
    return np.lib.stride_tricks.as_strided(rotations[0].T.reshape(-1), (count, 12), (96, 8))


_NO_PAIR = ClosestPair(float("inf"), (), np.full((2, 3), np.nan))

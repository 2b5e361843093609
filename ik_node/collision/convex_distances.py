"""Exact distances of convex solids by coal, many pairs after another with little Python in between.

Writing to and reading from coal's objects one attribute at a time takes several times as long as the computation. One
call per pair remains here: the results are read from coal's memory as one array, whose layout is checked when it is
created, and a transform is written once per link or obstacle.
"""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from ik_node.collision.distance_kernels import DISTANCE, FIRST, FIRST_GUESS, NORMAL, NOT_COMPUTED, SECOND
from ik_node.collision.scene import Shape
from ik_node.math.types import Array

TOLERANCE = 1e-9
"""Tolerance of GJK, m2. Distances of cylinders are then accurate to about 1e-9 m, those of flat solids and spheres to
rounding. The tolerance of EPA stays at its default of 1e-6: EPA fails in deep penetration with a smaller one."""

MAX_PROGRAMS = 4096
"""Combinations of link and obstacle shape whose programs are kept; obstacles of one shape share them."""


def make_solid(shape: Shape) -> Any:
    """The coal solid of a shape."""
    if shape.kind == "sphere":
        return coal.Sphere(*shape.size)
    if shape.kind == "box":
        return coal.Box(*shape.size)
    return (coal.Cylinder if shape.kind == "cylinder" else coal.Capsule)(*shape.size)


class ConvexDistances:
    """Programs of pairs of solids and memory for their results; a result does not depend on earlier ones."""

    def __init__(self, solids: list[Any]) -> None:
        """Starts without programs.

        Args:
            solids: The coal solids of the links.
        """
        self._solids = solids
        self._programs: dict[tuple[int, int | Shape], tuple[Any, Any]] = {}
        self.reserve(16)

    def reserve(self, count: int) -> None:
        """Makes room for the results of ``count`` pairs."""
        request = coal.DistanceRequest()
        request.gjk_tolerance, request.gjk_initial_guess = TOLERANCE, coal.GJKInitialGuess.CachedGuess
        requests, results = coal.StdVec_DistanceRequest(), coal.StdVec_DistanceResult()
        requests.extend([request] * (count + 1))
        results.extend([coal.DistanceResult() for _ in range(count + 1)])
        self._items = [(requests[row], results[row]) for row in range(count)]
        self.guesses = _guesses(requests, count)
        """(rows, numbers): the guess with which each request starts, see :data:`FIRST_GUESS`."""
        self.results = _results(results, count)
        """(rows, numbers): the results, with the columns of :mod:`.distance_kernels`."""
        self.results[:, DISTANCE] = NOT_COMPUTED

    def program(self, first: int, second: int, shape: Shape | None) -> Any:
        """Program of a link and another link, or of a link and an obstacle of a shape.

        It is called with the transforms of both solids, a request and a result.
        """
        key = first, second if shape is None else shape
        found = self._programs.get(key)
        if found is None:
            if len(self._programs) >= MAX_PROGRAMS:
                self._programs.clear()
            solid = self._solids[second] if shape is None else make_solid(shape)
            found = self._programs[key] = coal.ComputeDistance(self._solids[first], solid), solid
        return found[0]

    def rows(self, begin: int, end: int) -> list[tuple[Any, Any]]:
        """Request and result of the rows ``begin`` to ``end``; those before ``begin`` keep their numbers."""
        if end > len(self._items):
            kept = self.results[:begin].copy()
            self.reserve(2 * end)
            self.results[:begin] = kept
        return self._items[begin:end]


def _guesses(requests: Any, count: int) -> Array:
    """The numbers of ``count`` requests, (count, numbers), which start with the guess and the corners of the support.

    Raises RuntimeError when coal's memory is not laid out as expected.
    """
    memory = _rows(requests, [requests[row].cached_gjk_guess for row in (0, 1)], 0, count)
    requests[1].cached_gjk_guess = np.array([2.0, -3.0, 4.0])
    requests[1].cached_support_func_guess = np.array([5, 6], dtype=np.int32)
    corners = memory[1, 3:4].view(np.int32).tolist() if memory.shape[1] > 3 else []
    if memory[1, :3].tolist() != [2.0, -3.0, 4.0] or corners != [5, 6]:
        raise RuntimeError("unsupported memory layout of coal.DistanceRequest")
    memory[:, :4] = FIRST_GUESS
    return memory


def _results(results: Any, count: int) -> Array:
    """The numbers of ``count`` results, (count, numbers), which start with the distance.

    Raises RuntimeError when coal's memory is not laid out as expected.
    """
    memory = _rows(results, [results[row].normal for row in (0, 1)], NORMAL, count)
    one, other = coal.Sphere(0.1), coal.Sphere(0.25)
    places = coal.Transform3s(np.eye(3), np.array([0.5, -1.0, 2.0])), coal.Transform3s(np.eye(3), np.ones(3))
    order = [DISTANCE, *(start + axis for start in (NORMAL, FIRST, SECOND) for axis in range(3))]
    for row in (0, count - 1):
        result = results[row]
        coal.distance(one, places[0], other, places[1], coal.DistanceRequest(), result)
        expected = [result.min_distance, *result.normal, *result.getNearestPoint1(), *result.getNearestPoint2()]
        if memory.shape[1] <= max(order) or memory[row, order].tolist() != expected:
            raise RuntimeError("unsupported memory layout of coal.DistanceResult")
    return memory


class _Memory:
    """Rows of numbers inside a vector of coal. NumPy keeps this object with its array, and so the vector."""

    def __init__(self, vector: Any, address: int, shape: tuple[int, int]) -> None:
        self.vector = vector
        self.__array_interface__ = {"data": (address, False), "shape": shape, "typestr": "<f8", "version": 3}


def _rows(vector: Any, members: list[Array], column: int, count: int) -> Array:
    """``count`` objects of equal distance in memory as rows of numbers; ``members`` of the first two are at
    ``column``."""
    places = [member.__array_interface__["data"][0] for member in members]
    stride = places[1] - places[0]
    if stride % 8 or stride <= 0 or any(member.flags.owndata for member in members):
        raise RuntimeError("unsupported memory layout of coal's vectors")
    return np.asarray(_Memory(vector, places[0] - 8 * column, (count, stride // 8)))

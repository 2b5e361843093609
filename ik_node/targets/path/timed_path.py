"""A path over time: its geometry, and the law by which it is gone through where its own parameter is not time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.motion import NO_POSE, Motion
from ik_node.jit import compiled
from ik_node.math.quaternion import Quaternion, Vector, position_in
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import RigidMotion, mean_twist, pose_of
from ik_node.targets.path.se3_spline import Knots, RigidSpline, SplineTable, nearest_on, pose_on
from ik_node.targets.path.time_scaling import LawTable, TimeLaw, law_place
from ik_node.targets.stream.extrapolation import resting
from ik_node.targets.transition import NO_OFFSET, Offset, part_of_way, placed, planned, slowed

NO_LAW = np.zeros((0, 5))


class PathTable(NamedTuple):
    """A path's numbers."""

    spline: SplineTable
    law: Array
    """:attr:`TimeLaw.rows`; none where the knots' parameter is time."""
    window_s: float


class TimedPath:
    """Immutable."""

    def __init__(self, knots: Knots, law: LawTable | None) -> None:
        """``law``: None where the knots' parameter is time in seconds."""
        self.spline = RigidSpline(knots)
        self._law = None if law is None else TimeLaw(law)
        rows, window_s = (NO_LAW, 0.0) if self._law is None else (self._law.rows, self._law.window_s)
        self._table = PathTable(self.spline.table, rows, window_s)

    @property
    def end_s(self) -> float:
        """When it ends; it begins at 0."""
        return self.spline.end_s if self._law is None else self._law.duration_s

    def pose(self, time_s: float) -> tuple[Vector, Quaternion]:
        """Position [m] and orientation (w, x, y, z); held at its ends."""
        return self.spline.pose(time_s if self._law is None else self._law.place(time_s))

    def motion(self, time_s: float) -> RigidMotion:
        """Pose, velocity and acceleration."""
        if self._law is None:
            return self.spline.motion(time_s)
        return slowed(self.spline.motion(self._law.place(time_s)), *self._law.rates(time_s))

    def led(
        self, begin_s: float, end_s: float, hold_s: float, offset: Offset | None, pose_sb: Array | None, part: float
    ) -> tuple[Motion, Offset | None, float]:
        """The motion from ``begin_s`` to ``end_s`` of the path, at an ``offset`` from it, with that for ``hold_s``.

        The twist belongs to the ``part`` of ``hold_s`` that the way takes. Last comes how near the path comes to the
        tool [m], looked for downhill from where it is at ``begin_s``; NaN without ``pose_sb`` (4, 4).
        """
        motion, after, distance_m = _led(
            self._table,
            begin_s,
            end_s,
            hold_s,
            offset or NO_OFFSET,
            offset is not None,
            NO_POSE if pose_sb is None else np.ascontiguousarray(pose_sb),
            part,
        )
        return motion, after if offset is not None else None, distance_m

    def resting(self, time_s: float) -> RigidMotion:
        """At rest at one pose of the path."""
        position, orientation = self.pose(time_s)
        return RigidMotion(position, orientation=orientation)


@compiled
def _led(
    path: PathTable,
    begin_s: float,
    end_s: float,
    hold_s: float,
    offset: Offset,
    is_off: bool,
    pose_sb: Array,
    part: float,
) -> tuple[Motion, Offset, float]:
    """:meth:`TimedPath.led`; ``is_off``: whether there is an offset."""
    begin, end = _place(path, begin_s), _place(path, end_s)
    position, orientation = pose_on(path.spline, begin)
    now = resting(position, orientation)
    position, orientation = pose_on(path.spline, end)
    then = resting(position, orientation)
    if is_off:
        offset, after = planned(offset, hold_s)
        now = placed(now, offset.motion)
        then = placed(then, part_of_way(offset.motion, after, part))
    distance_m = nearest_on(path.spline, position_in(pose_sb), begin)[1]
    return Motion(pose_of(now), mean_twist(now, then, part * hold_s)), offset, distance_m


@compiled
def _place(path: PathTable, time_s: float) -> float:
    """The parameter of the spline."""
    return time_s if len(path.law) == 0 else law_place(path.law, path.window_s, time_s)

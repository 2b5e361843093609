"""A path as a function of time: its spline, and a time scaling if the parameter of the spline is not time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.motion import NO_POSE, Motion
from ik_node.jit import compiled
from ik_node.math.quaternion import Quaternion, Vector, pose_position
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import RigidMotion, mean_twist, pose_matrix
from ik_node.targets.path.se3_spline import Knots, RigidSpline, SplineTable, nearest_on, pose_on
from ik_node.targets.path.time_scaling import TimeScaling, TimeScalingTable, place_at
from ik_node.targets.stream.extrapolation import resting
from ik_node.targets.transition import NO_TRANSITION, Transition, interpolated, placed, planned, slowed

NO_TIME_SCALING = np.zeros((0, 5))


class PathTable(NamedTuple):
    """The numbers of a path, for compiled functions."""

    spline: SplineTable
    time_scaling: Array
    """:attr:`TimeScaling.rows`; empty if the parameter of the knots is time."""
    window_s: float


class TimedPath:
    """A path with times; immutable."""

    def __init__(self, knots: Knots, time_scaling: TimeScalingTable | None) -> None:
        """``time_scaling``: None if the parameter of the knots is time in seconds."""
        self.spline = RigidSpline(knots)
        self._time_scaling = None if time_scaling is None else TimeScaling(time_scaling)
        rows, window_s = (
            (NO_TIME_SCALING, 0.0)
            if self._time_scaling is None
            else (self._time_scaling.rows, self._time_scaling.window_s)
        )
        self.table = PathTable(self.spline.table, rows, window_s)

    @property
    def end_s(self) -> float:
        """Time of its end; it begins at 0."""
        return self.spline.end_s if self._time_scaling is None else self._time_scaling.duration_s

    def pose(self, time_s: float) -> tuple[Vector, Quaternion]:
        """Position [m] and orientation (w, x, y, z); constant beyond the ends."""
        return self.spline.pose(time_s if self._time_scaling is None else self._time_scaling.place(time_s))

    def motion(self, time_s: float) -> RigidMotion:
        """Pose, velocity and acceleration."""
        if self._time_scaling is None:
            return self.spline.motion(time_s)
        return slowed(self.spline.motion(self._time_scaling.place(time_s)), *self._time_scaling.rates(time_s))

    def advance(
        self,
        begin_s: float,
        end_s: float,
        hold_s: float,
        transition: Transition | None,
        pose_sb: Array | None,
        part: float,
    ) -> tuple[Motion, Transition | None, float]:
        """The motion from ``begin_s`` to ``end_s`` of the path.

        Args:
            begin_s: Time on the path now.
            end_s: Time on the path after the control interval.
            hold_s: Length of the control interval.
            transition: Transition onto the path; None on the path.
            pose_sb: Measured T_sb (4, 4), for the distance; None for a distance of NaN.
            part: Fraction of ``hold_s`` to which the way from ``begin_s`` to ``end_s`` corresponds.

        Returns:
            Pose and mean twist, the transition with its schedule for ``hold_s``, and the distance of the tool from the
            path [m], found by descent from ``begin_s``.
        """
        motion, after, distance_m = _led(
            self.table,
            begin_s,
            end_s,
            hold_s,
            transition or NO_TRANSITION,
            transition is not None,
            NO_POSE if pose_sb is None else np.ascontiguousarray(pose_sb),
            part,
        )
        return motion, after if transition is not None else None, distance_m

    def resting(self, time_s: float) -> RigidMotion:
        """A pose of the path as a motion at rest."""
        position, orientation = self.pose(time_s)
        return RigidMotion(position, orientation=orientation)


@compiled
def _led(
    path: PathTable,
    begin_s: float,
    end_s: float,
    hold_s: float,
    transition: Transition,
    has_transition: bool,
    pose_sb: Array,
    part: float,
) -> tuple[Motion, Transition, float]:
    """:meth:`TimedPath.advance`; ``has_transition``: False if there is no transition."""
    begin = _place(path, begin_s)
    now, then = resting_on(path, begin_s), resting_on(path, end_s)
    if has_transition:
        transition, after = planned(transition, hold_s)
        now = placed(now, transition.motion)
        then = placed(then, interpolated(transition.motion, after, part))
    distance_m = nearest_on(path.spline, pose_position(pose_sb), begin)[1]
    return Motion(pose_matrix(now), mean_twist(now, then, part * hold_s)), transition, distance_m


@compiled
def resting_on(path: PathTable, time_s: float) -> RigidMotion:
    """:meth:`TimedPath.resting`."""
    position, orientation = pose_on(path.spline, _place(path, time_s))
    return resting(position, orientation)


@compiled
def _place(path: PathTable, time_s: float) -> float:
    """The parameter of the spline at ``time_s``."""
    return time_s if len(path.time_scaling) == 0 else place_at(path.time_scaling, path.window_s, time_s)

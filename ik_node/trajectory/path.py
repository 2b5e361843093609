"""Following a path that came as a whole.

The path itself is a :class:`ik_node.trajectory.rigid_spline.RigidSpline`; the reference gets onto it by an
:mod:`ik_node.trajectory.offset`. How a path begins:

* The arm is within ``join_distance`` and ``join_angle`` of where the path is now: it joins there, at the right time.
* Otherwise the arm goes straight and with the shortest turn to the path's first pose, and waits there for its time.
* Where that has gone by when the arm arrives, the path begins late and stays late: no part of it is left out.

A path that is under way where it begins, or where it is joined by an arm that is not, gathers speed over ``RAMP_S``
instead of dragging the arm off its geometry; and one that is under way where it ends loses speed before that. Either
makes it later by half of ``RAMP_S``.

Time on the path goes by as the arm gets on: ``pace`` is the part s of the last twist that the limits let through. So
the arm stays on the path's geometry, and everything after comes later.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from math import nan

from ik_node.clock import NS
from ik_node.errors import InputError
from ik_node.se3 import Array
from ik_node.settings import PathSettings
from ik_node.trajectory.knot_rates import through_poses
from ik_node.trajectory.motion import Motion
from ik_node.trajectory.offset import (
    Limits,
    Offset,
    advanced,
    between,
    composed,
    is_near,
    likely_part,
    part_of_way,
    placed,
    planned,
    slowed,
)
from ik_node.trajectory.reference import Bounds, RigidMotion, mean_twist, pose_of
from ik_node.trajectory.rigid_spline import Knots, RigidSpline
from ik_node.trajectory.rotations import difference, length
from ik_node.trajectory.route import Route

ARRIVED_M, ARRIVED_RAD = 5e-4, 2e-3
"""An approach has arrived when it is this near."""
MOVING_M_S, MOVING_RAD_S = 1e-3, 5e-3
"""What is faster than this is under way."""
RAMP_S = 0.5
"""Over this time a path gathers or loses speed that is under way where it begins or ends."""
TURN_LENGTH_M = 0.3
"""Length that makes turning rates comparable with speeds, for choosing the smaller jump."""
LONGEST_GAP_S = 0.25
"""Ticks that were missed for longer than this are not made up for."""


@dataclass
class PathState:
    """Everything that is remembered of a path. Values are immutable, so that a shallow copy is a snapshot."""

    time_ns: int = 0
    knots: Knots | None = None
    begin_ns: int | None = None
    offset: Offset | None = None
    entry_s: float = 0.0
    """Where on the path it is begun."""
    rise_s: float = 0.0
    """Over this time it gathers speed."""
    fall_s: float = 0.0
    """Over this time it loses speed."""
    clock_s: float | None = None
    """Time that has gone by on the path since it was begun there; None before."""
    pace: float = 1.0
    distance_m: float = nan


class PathFollower:
    """One path after the other. All times are monotonic nanoseconds."""

    def __init__(self, settings: PathSettings) -> None:
        self.configure(settings)
        self._state = PathState()
        self._spline: RigidSpline | None = None

    def configure(self, settings: PathSettings) -> None:
        """Other settings from now on."""
        self._settings = settings
        s = settings
        self._limits = Limits(
            Bounds(
                s.approach_linear_speed, s.approach_linear_acceleration, s.approach_linear_jerk, s.approach_linear_speed
            ),
            Bounds(
                s.approach_angular_speed,
                s.approach_angular_acceleration,
                s.approach_angular_jerk,
                s.approach_angular_speed,
            ),
        )

    def state(self) -> PathState:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, state: PathState) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(state)
        self._spline = None if state.knots is None else RigidSpline(state.knots)

    # --- beginning ---------------------------------------------------------------------------------------------------

    def begin(self, route: Route, reference: RigidMotion, time_ns: int) -> None:
        """A path to follow from now on; ``reference`` is where the arm is led to at ``time_ns``, and how it moves."""
        due = route.begin_ns is None or route.begin_ns <= time_ns
        moving = due and route.begin_ns is not None and is_moving(reference)
        knots = route.knots or through_poses(route.times_s, route.positions, route.orientations, moving)
        s = self._state = PathState(time_ns=time_ns, knots=knots, begin_ns=route.begin_ns)
        spline = self._spline = RigidSpline(knots)
        if route.begin_ns is not None and due:
            s.entry_s = min((time_ns - route.begin_ns) / NS, spline.end_s)
        s.offset = between(reference, resting_at(spline, s.entry_s))
        if due and self._is_joinable():
            self._join(reference)
            return
        if moving and route.knots is None:
            s.knots = through_poses(route.times_s, route.positions, route.orientations, False)
            spline = self._spline = RigidSpline(s.knots)
        s.entry_s = 0.0
        self._set_ramps(is_moving(spline.motion(0.0)))
        s.offset = between(reference, resting_at(spline, 0.0))

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Goes on with the path from somewhere else."""
        s = self._state
        s.time_ns, s.pace = time_ns, 1.0
        s.offset = between(reference, self._goal())

    def _is_joinable(self) -> bool:
        offset = self._state.offset
        return offset is None or is_near(offset, self._settings.join_distance, self._settings.join_angle)

    def _join(self, reference: RigidMotion) -> None:
        """Onto a path under way: at full speed, or gathering it, whichever is nearer to how ``reference`` moves."""
        s, spline = self._state, self._route()
        s.clock_s = 0.0
        goal, still = spline.motion(s.entry_s), resting_at(spline, s.entry_s)
        self._set_ramps(is_moving(goal) and _jump(reference, still) < _jump(reference, goal))
        s.offset = between(reference, self._goal())

    def _set_ramps(self, rise: bool) -> None:
        s, spline = self._state, self._route()
        ramp_s = min(RAMP_S, spline.end_s - s.entry_s)
        s.rise_s = ramp_s if rise else 0.0
        s.fall_s = ramp_s if is_moving(spline.motion(spline.end_s)) else 0.0

    # --- ticks -------------------------------------------------------------------------------------------------------

    def advance(self, time_ns: int, hold_s: float, pace: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``pace``: the part of the last twist that the arm did. The twist belongs to the way that will be gone if that
        goes on, lest arcs be cut short. ``pose_sb``: where the tool is, for its distance.
        """
        self._catch_up(time_ns, pace)
        s, spline = self._state, self._route()
        part = likely_part(pace)
        begin, end = self._path_time(s.clock_s), self._path_time(self._clock_after(part * hold_s))
        offset, offset_after = None, None
        if s.offset is not None:
            s.offset, offset_after = planned(s.offset, hold_s, self._limits)
            offset = s.offset.motion
            offset_after = part_of_way(offset, offset_after, part)
        now = placed(*spline.pose(begin), offset)
        then = placed(*spline.pose(end), offset_after)
        if pose_sb is not None:
            x, y, z = pose_sb[:3, 3].tolist()
            s.distance_m = spline.nearest((x, y, z), begin)[1]
        return Motion(pose_of(now), mean_twist(now, then, part * hold_s))

    def _catch_up(self, time_ns: int, pace: float) -> None:
        s = self._state
        before_ns, elapsed_s = s.time_ns, min(max((time_ns - s.time_ns) / NS, 0.0), LONGEST_GAP_S)
        s.pace = pace
        if s.offset is not None:
            s.offset = advanced(s.offset, elapsed_s, pace, self._limits)
        s.time_ns = max(s.time_ns, time_ns)
        if s.clock_s is not None:
            s.clock_s += pace * elapsed_s
            return
        begin_ns = s.begin_ns
        if begin_ns is not None and time_ns < begin_ns:
            return
        if begin_ns is not None and before_ns < begin_ns and self._is_joinable():
            s.clock_s = (time_ns - begin_ns) / NS
        elif s.offset is None or is_near(s.offset, ARRIVED_M, ARRIVED_RAD):
            s.clock_s = 0.0

    def motion(self) -> RigidMotion:
        """The reference now, as the arm follows it."""
        return slowed(composed(self._goal(), self._state.offset), self._state.pace, 0.0)

    def _goal(self) -> RigidMotion:
        """Where the path is now, and how it moves."""
        s, spline = self._state, self._route()
        if s.clock_s is None or self.finished:
            return resting_at(spline, self._path_time(s.clock_s))
        motion, left_s = spline.motion(self._path_time(s.clock_s)), self._duration_s - s.clock_s
        for ramp_s, gone_s, sign in ((s.rise_s, s.clock_s, 1.0), (s.fall_s, left_s, -1.0)):
            if gone_s < ramp_s:
                u = gone_s / ramp_s
                return slowed(motion, u * u * (3.0 - 2.0 * u), sign * 6.0 * u * (1.0 - u) / ramp_s)
        return motion

    def _clock_after(self, hold_s: float) -> float | None:
        s = self._state
        if s.clock_s is not None:
            return s.clock_s + hold_s
        if s.begin_ns is None or not self._is_joinable():
            return None
        left_s = hold_s - (s.begin_ns - s.time_ns) / NS
        return left_s if left_s > 0.0 and s.begin_ns > s.time_ns else None

    @property
    def _duration_s(self) -> float:
        """How long the path takes from where it is begun."""
        s = self._state
        return self._route().end_s - s.entry_s + 0.5 * (s.rise_s + s.fall_s)

    def _path_time(self, clock_s: float | None) -> float:
        """Time on the path; while it gathers or loses speed the integral of 3 u^2 - 2 u^3."""
        s, end_s = self._state, self._route().end_s
        if clock_s is None:
            return s.entry_s
        left_s = self._duration_s - clock_s
        if left_s <= 0.0:
            return end_s
        if clock_s < s.rise_s:
            return s.entry_s + _ramp(clock_s, s.rise_s)
        if left_s < s.fall_s:
            return end_s - _ramp(left_s, s.fall_s)
        return s.entry_s + clock_s - 0.5 * s.rise_s

    def _route(self) -> RigidSpline:
        if self._spline is None:
            raise InputError("no path has been given")
        return self._spline

    # --- what there is to say ----------------------------------------------------------------------------------------

    @property
    def waiting(self) -> bool:
        """The path has not begun: the arm is on its way to it, or there and early."""
        return self._state.clock_s is None

    @property
    def early(self) -> bool:
        """The path has not begun, and the arm is there."""
        s = self._state
        return s.clock_s is None and (s.offset is None or is_near(s.offset, ARRIVED_M, ARRIVED_RAD))

    @property
    def finished(self) -> bool:
        """The path has come to its end."""
        clock_s = self._state.clock_s
        return clock_s is not None and clock_s >= self._duration_s

    @property
    def progress(self) -> float:
        """Part of the path's time that has gone by, 0 to 1."""
        return self._path_time(self._state.clock_s) / self._route().end_s if self._state.clock_s is not None else 0.0

    @property
    def late_s(self) -> float:
        """How much later than by its stamps the path is now [s]; 0 for a path that may begin at any time."""
        s = self._state
        if s.begin_ns is None or self.finished:
            return 0.0
        return max((s.time_ns - s.begin_ns) / NS - self._path_time(s.clock_s), 0.0)

    @property
    def distance_m(self) -> float:
        """Distance of the tool point from the path [m]; NaN while not known."""
        return self._state.distance_m

    @property
    def goal_sd(self) -> Array:
        """The path's last pose, (4, 4)."""
        spline = self._route()
        return pose_of(placed(*spline.pose(spline.end_s), None))


def is_moving(motion: RigidMotion) -> bool:
    """Whether it is under way."""
    return length(motion.velocity) > MOVING_M_S or length(motion.rate) > MOVING_RAD_S


def resting_at(spline: RigidSpline, time_s: float) -> RigidMotion:
    """At rest at one pose of the path."""
    position, orientation = spline.pose(time_s)
    return RigidMotion(position, orientation=orientation)


def _ramp(time_s: float, ramp_s: float) -> float:
    """How far a clock gets in ``time_s`` that gathers speed over ``ramp_s``."""
    u = time_s / ramp_s
    return ramp_s * u**3 * (1.0 - 0.5 * u)


def _jump(a: RigidMotion, b: RigidMotion) -> float:
    """How different two motions' velocities are [m/s]."""
    return length(difference(a.velocity, b.velocity)) + TURN_LENGTH_M * length(difference(a.rate, b.rate))

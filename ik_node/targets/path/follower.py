"""Following a path that came as a whole.

The path itself is a :class:`ik_node.targets.path.se3_spline.RigidSpline`; the reference gets onto it by an
:mod:`ik_node.targets.transition`. How a path begins:

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
from dataclasses import dataclass, field
from math import nan

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.math.quaternion import difference, length
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_of
from ik_node.targets.path.request import Route
from ik_node.targets.path.se3_spline import Knots
from ik_node.targets.path.speed_ramp import PathClock
from ik_node.targets.path.spline_fit import through_poses
from ik_node.targets.path.time_parametrisation import JointSearch, PathTiming, is_done
from ik_node.targets.path.time_scaling import LawTable
from ik_node.targets.path.timed_path import TimedPath
from ik_node.targets.transition import (
    Limits,
    Offset,
    advanced,
    between,
    bounds,
    composed,
    is_near,
    likely_part,
    slowed,
)

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
class PathSnapshot:
    """Everything that is remembered of a path. Values are immutable, so that a shallow copy is a snapshot."""

    time_ns: int = 0
    knots: Knots | None = None
    law: LawTable | None = None
    search: JointSearch | None = None
    """What is still to be found out before a path without times can begin."""
    begin_ns: int | None = None
    offset: Offset | None = None
    clock: PathClock = field(default_factory=PathClock)
    clock_s: float | None = None
    """Time that has gone by since the path was begun; None before."""
    pace: float = 1.0
    distance_m: float = nan


class PathFollower:
    """One path after the other. All times are monotonic nanoseconds."""

    def __init__(self, settings: Settings, robot: Robot | None = None) -> None:
        """``robot``: so that paths without times get some that its joints can keep; else the tool's bounds count."""
        self._timing = PathTiming(settings, robot)
        self.configure(settings)
        self._state = PathSnapshot()
        self._timed: TimedPath | None = None

    def configure(self, settings: Settings) -> None:
        """Other settings from now on."""
        self._timing.configure(settings)
        s = self._settings = settings.path
        self._limits = Limits(
            bounds(s.approach_linear_speed, s.approach_linear_acceleration, s.approach_linear_jerk),
            bounds(s.approach_angular_speed, s.approach_angular_acceleration, s.approach_angular_jerk),
        )

    def capture(self) -> PathSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: PathSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._timed = None if snapshot.knots is None else TimedPath(snapshot.knots, snapshot.law)

    def forget(self) -> None:
        """No path any more."""
        self._state, self._timed = PathSnapshot(), None

    # --- beginning ---------------------------------------------------------------------------------------------------

    def begin(self, route: Route, reference: RigidMotion, time_ns: int, q: Array | None = None) -> None:
        """A path to follow from now on.

        ``reference`` is where the arm is led to at ``time_ns``, and how it moves; ``q`` (n,) where its joints are.
        """
        due = route.begin_ns is None or route.begin_ns <= time_ns
        moving = due and route.begin_ns is not None and is_moving(reference)
        s = self._state = PathSnapshot(time_ns=time_ns, begin_ns=route.begin_ns)
        self._set_knots(route, moving)
        if not route.timed:
            s.search = self._timing.begin(self._path.spline, q)
            if s.search is None:
                self._set_law()
        path = self._path
        entry_s = 0.0
        if route.begin_ns is not None and due:
            entry_s = min((time_ns - route.begin_ns) / NS, path.end_s)
        s.offset = between(reference, path.resting(entry_s), self._limits)
        if due and self._is_joinable() and s.search is None:
            self._join(reference, entry_s)
            return
        if moving:
            self._set_knots(route, False)
        self._set_clock(0.0, is_moving(self._path.motion(0.0)))
        s.offset = between(reference, self._path.resting(0.0), self._limits)

    def _set_knots(self, route: Route, moving_start: bool) -> None:
        knots = route.knots or through_poses(route.times_s, route.positions, route.orientations, moving_start)
        self._state.knots = knots
        self._timed = TimedPath(knots, None)

    def _set_law(self) -> None:
        """The search for it, if there was one, is done."""
        s = self._state
        if s.knots is not None:
            s.law = self._timing.law(self._path.spline, s.search)
            s.search = None
            self._timed = TimedPath(s.knots, s.law)
            self._set_clock(0.0, False)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Goes on with the path from rest somewhere else: back to where it was left, and on from there."""
        s = self._state
        left_s = self._path_time(s.clock_s)
        s.time_ns, s.pace, s.clock_s = time_ns, 1.0, None
        self._set_clock(left_s, is_moving(self._path.motion(left_s)))
        s.offset = between(reference, self._goal(), self._limits)

    def _is_joinable(self) -> bool:
        offset = self._state.offset
        return offset is None or is_near(offset, self._settings.join_distance, self._settings.join_angle)

    def _join(self, reference: RigidMotion, entry_s: float) -> None:
        """Onto a path under way: at full speed, or gathering it, whichever is nearer to how ``reference`` moves."""
        s, path = self._state, self._path
        goal, still = path.motion(entry_s), path.resting(entry_s)
        self._set_clock(entry_s, is_moving(goal) and _jump(reference, still) < _jump(reference, goal))
        s.clock_s = 0.0
        s.offset = between(reference, self._goal(), self._limits)

    def _set_clock(self, entry_s: float, rise: bool) -> None:
        path = self._path
        ramp_s = min(RAMP_S, path.end_s - entry_s)
        fall = is_moving(path.motion(path.end_s))
        self._state.clock = PathClock(entry_s, path.end_s, ramp_s if rise else 0.0, ramp_s if fall else 0.0)

    # --- ticks -------------------------------------------------------------------------------------------------------

    def advance(self, time_ns: int, hold_s: float, pace: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``pace``: the part of the last twist that the arm did. The twist belongs to the way that will be gone if that
        goes on, lest arcs be cut short. ``pose_sb``: where the tool is, for its distance.
        """
        self._catch_up(time_ns, pace)
        s, path = self._state, self._path
        part = likely_part(pace)
        begin, end = self._path_time(s.clock_s), self._path_time(self._clock_after(part * hold_s))
        motion, s.offset, distance_m = path.led(begin, end, hold_s, s.offset, pose_sb, part)
        if pose_sb is not None:
            s.distance_m = distance_m
        return motion

    def _catch_up(self, time_ns: int, pace: float) -> None:
        s = self._state
        before_ns, elapsed_s = s.time_ns, min(max((time_ns - s.time_ns) / NS, 0.0), LONGEST_GAP_S)
        s.pace = pace
        if s.offset is not None:
            s.offset = advanced(s.offset, elapsed_s, pace)
        s.time_ns = max(s.time_ns, time_ns)
        if s.clock_s is not None:
            s.clock_s += pace * elapsed_s
            return
        if s.search is not None:
            s.search = self._timing.go_on(self._path.spline, s.search)
            if not is_done(s.search):
                return
            self._set_law()
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
        s, path = self._state, self._path
        if s.clock_s is None or self.finished:
            return path.resting(self._path_time(s.clock_s))
        return slowed(path.motion(self._path_time(s.clock_s)), *s.clock.pace(s.clock_s))

    def _clock_after(self, hold_s: float) -> float | None:
        s = self._state
        if s.clock_s is not None:
            return s.clock_s + hold_s
        if s.begin_ns is None or not self._is_joinable():
            return None
        left_s = hold_s - (s.begin_ns - s.time_ns) / NS
        return left_s if left_s > 0.0 and s.begin_ns > s.time_ns else None

    def _path_time(self, clock_s: float | None) -> float:
        clock = self._state.clock
        return clock.entry_s if clock_s is None else clock.time_s(clock_s)

    @property
    def _path(self) -> TimedPath:
        if self._timed is None:
            raise InputError("no path has been given")
        return self._timed

    # --- what there is to say ----------------------------------------------------------------------------------------

    @property
    def waiting(self) -> bool:
        """The path has not begun: the arm is on its way to it, or there and early."""
        return self._state.clock_s is None

    @property
    def timing(self) -> bool:
        """Times are being looked for, and the path has not begun."""
        return self._state.search is not None

    @property
    def early(self) -> bool:
        """The path has not begun, and the arm is there."""
        s = self._state
        return s.clock_s is None and (s.offset is None or is_near(s.offset, ARRIVED_M, ARRIVED_RAD))

    @property
    def finished(self) -> bool:
        """The path has come to its end."""
        s = self._state
        return s.clock_s is not None and s.clock_s >= s.clock.duration_s

    @property
    def progress(self) -> float:
        """Part of the path's time that has gone by, 0 to 1."""
        return self._path_time(self._state.clock_s) / self._path.end_s

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
        return pose_of(self._path.resting(self._path.end_s))


def is_moving(motion: RigidMotion) -> bool:
    """Whether it is under way."""
    return length(motion.velocity) > MOVING_M_S or length(motion.rate) > MOVING_RAD_S


def _jump(a: RigidMotion, b: RigidMotion) -> float:
    """How different two motions' velocities are [m/s]."""
    return length(difference(a.velocity, b.velocity)) + TURN_LENGTH_M * length(difference(a.rate, b.rate))

"""Following a path that came as a whole.

The path itself is a :class:`ik_node.targets.path.se3_spline.RigidSpline`; the reference gets onto it by an
:mod:`ik_node.targets.transition`. How a path begins:

* The arm is within ``JOIN_M`` and ``JOIN_RAD`` of where the path is now: it joins there, at the right time.
* Otherwise the arm goes straight and with the shortest turn to the path's first pose, and waits there for its time.
* Where that has gone by when the arm arrives, the path begins late and stays late: no part of it is left out.

A path that is under way where it begins, or where it is joined by an arm that is not, gathers speed over ``RAMP_S``
instead of dragging the arm off its geometry; and one that is under way where it ends loses speed before that. Either
makes it later by half of ``RAMP_S``.

Time on the path goes by as the arm gets on: ``time_rate`` is the part s of the last twist that the limits let through. So
the arm stays on the path's geometry, and everything after comes later.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import nan

from ik_node.errors import InputError
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.clock import NS
from ik_node.math.quaternion import difference, length
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.targets.bounds import APPROACH, motion_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.path.request import PathRequest
from ik_node.targets.path.se3_spline import Knots
from ik_node.targets.path.speed_ramp import SpeedRamp
from ik_node.targets.path.spline_fit import through_poses
from ik_node.targets.path.time_parametrisation import JointSearch, PathTiming, is_done
from ik_node.targets.path.time_scaling import TimeScalingTable
from ik_node.targets.path.timed_path import TimedPath
from ik_node.targets.transition import (
    Transition,
    advanced,
    composed,
    expected_time_rate,
    is_near,
    slowed,
    start_transition,
)

JOIN_M, JOIN_RAD = 0.02, 0.1
"""A path that has begun is joined at its present pose if that is no further away than this, else at its start."""
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
    time_scaling: TimeScalingTable | None = None
    search: JointSearch | None = None
    """What is still to be found out before a path without times can begin."""
    begin_ns: int | None = None
    transition: Transition | None = None
    ramp: SpeedRamp = field(default_factory=SpeedRamp)
    clock_s: float | None = None
    """Time that has gone by since the path was begun; None before."""
    time_rate: float = 1.0
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
        self._limits = motion_bounds(settings.target, APPROACH)

    def capture(self) -> PathSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: PathSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._timed = None if snapshot.knots is None else TimedPath(snapshot.knots, snapshot.time_scaling)

    def forget(self) -> None:
        """No path any more."""
        self._state, self._timed = PathSnapshot(), None

    # --- beginning ---------------------------------------------------------------------------------------------------

    def begin(self, request: PathRequest, reference: RigidMotion, time_ns: int, q: Array | None = None) -> None:
        """A path to follow from now on.

        ``reference`` is where the arm is led to at ``time_ns``, and how it moves; ``q`` (n,) where its joints are.
        """
        due = request.begin_ns is None or request.begin_ns <= time_ns
        moving = due and request.begin_ns is not None and is_moving(reference)
        s = self._state = PathSnapshot(time_ns=time_ns, begin_ns=request.begin_ns)
        self._set_knots(request, moving)
        if not request.timed:
            s.search = self._timing.begin(self._path.spline, q)
            if s.search is None:
                self._set_time_scaling()
        path = self._path
        entry_s = 0.0
        if request.begin_ns is not None and due:
            entry_s = min((time_ns - request.begin_ns) / NS, path.end_s)
        s.transition = start_transition(reference, path.resting(entry_s), self._limits)
        if due and self._is_joinable() and s.search is None:
            self._join(reference, entry_s)
            return
        if moving:
            self._set_knots(request, False)
        self._set_ramp(0.0, is_moving(self._path.motion(0.0)))
        s.transition = start_transition(reference, self._path.resting(0.0), self._limits)

    def _set_knots(self, request: PathRequest, moving_start: bool) -> None:
        knots = request.knots or through_poses(request.times_s, request.positions, request.orientations, moving_start)
        self._state.knots = knots
        self._timed = TimedPath(knots, None)

    def _set_time_scaling(self) -> None:
        """The search for it, if there was one, is done."""
        s = self._state
        if s.knots is not None:
            s.time_scaling = self._timing.time_scaling(self._path.spline, s.search)
            s.search = None
            self._timed = TimedPath(s.knots, s.time_scaling)
            self._set_ramp(0.0, False)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Goes on with the path from rest somewhere else: back to where it was left, and on from there."""
        s = self._state
        left_s = self._path_time(s.clock_s)
        s.time_ns, s.time_rate, s.clock_s = time_ns, 1.0, None
        self._set_ramp(left_s, is_moving(self._path.motion(left_s)))
        s.transition = start_transition(reference, self._goal(), self._limits)

    def _is_joinable(self) -> bool:
        transition = self._state.transition
        return transition is None or is_near(transition, JOIN_M, JOIN_RAD)

    def _join(self, reference: RigidMotion, entry_s: float) -> None:
        """Onto a path under way: at full speed, or gathering it, whichever is nearer to how ``reference`` moves."""
        s, path = self._state, self._path
        goal, still = path.motion(entry_s), path.resting(entry_s)
        self._set_ramp(entry_s, is_moving(goal) and _jump(reference, still) < _jump(reference, goal))
        s.clock_s = 0.0
        s.transition = start_transition(reference, self._goal(), self._limits)

    def _set_ramp(self, entry_s: float, rise: bool) -> None:
        path = self._path
        ramp_s = min(RAMP_S, path.end_s - entry_s)
        fall = is_moving(path.motion(path.end_s))
        self._state.ramp = SpeedRamp(entry_s, path.end_s, ramp_s if rise else 0.0, ramp_s if fall else 0.0)

    # --- ticks -------------------------------------------------------------------------------------------------------

    def advance(self, time_ns: int, hold_s: float, time_rate: float = 1.0, pose_sb: Array | None = None) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        ``time_rate``: the part of the last twist that the arm did. The twist belongs to the way that will be gone if that
        goes on, lest arcs be cut short. ``pose_sb``: where the tool is, for its distance.
        """
        self._catch_up(time_ns, time_rate)
        s, path = self._state, self._path
        part = expected_time_rate(time_rate)
        begin, end = self._path_time(s.clock_s), self._path_time(self._clock_after(part * hold_s))
        motion, s.transition, distance_m = path.advance(begin, end, hold_s, s.transition, pose_sb, part)
        if pose_sb is not None:
            s.distance_m = distance_m
        return motion

    def _catch_up(self, time_ns: int, time_rate: float) -> None:
        s = self._state
        before_ns, elapsed_s = s.time_ns, min(max((time_ns - s.time_ns) / NS, 0.0), LONGEST_GAP_S)
        s.time_rate = time_rate
        if s.transition is not None:
            s.transition = advanced(s.transition, elapsed_s, time_rate)
        s.time_ns = max(s.time_ns, time_ns)
        if s.clock_s is not None:
            s.clock_s += time_rate * elapsed_s
            return
        if s.search is not None:
            s.search = self._timing.advanced_search(self._path.spline, s.search)
            if not is_done(s.search):
                return
            self._set_time_scaling()
        begin_ns = s.begin_ns
        if begin_ns is not None and time_ns < begin_ns:
            return
        if begin_ns is not None and before_ns < begin_ns and self._is_joinable():
            s.clock_s = (time_ns - begin_ns) / NS
        elif s.transition is None or is_near(s.transition, ARRIVED_M, ARRIVED_RAD):
            s.clock_s = 0.0

    def motion(self) -> RigidMotion:
        """The reference now, as the arm follows it."""
        return slowed(composed(self._goal(), self._state.transition), self._state.time_rate, 0.0)

    def _goal(self) -> RigidMotion:
        """Where the path is now, and how it moves."""
        s, path = self._state, self._path
        if s.clock_s is None or self.finished:
            return path.resting(self._path_time(s.clock_s))
        return slowed(path.motion(self._path_time(s.clock_s)), *s.ramp.time_rate(s.clock_s))

    def _clock_after(self, hold_s: float) -> float | None:
        s = self._state
        if s.clock_s is not None:
            return s.clock_s + hold_s
        if s.begin_ns is None or not self._is_joinable():
            return None
        left_s = hold_s - (s.begin_ns - s.time_ns) / NS
        return left_s if left_s > 0.0 and s.begin_ns > s.time_ns else None

    def _path_time(self, clock_s: float | None) -> float:
        ramp = self._state.ramp
        return ramp.entry_s if clock_s is None else ramp.time_s(clock_s)

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
        return s.clock_s is None and (s.transition is None or is_near(s.transition, ARRIVED_M, ARRIVED_RAD))

    @property
    def finished(self) -> bool:
        """The path has come to its end."""
        s = self._state
        return s.clock_s is not None and s.clock_s >= s.ramp.duration_s

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
        return pose_matrix(self._path.resting(self._path.end_s))


def is_moving(motion: RigidMotion) -> bool:
    """Whether it is under way."""
    return length(motion.velocity) > MOVING_M_S or length(motion.rate) > MOVING_RAD_S


def _jump(a: RigidMotion, b: RigidMotion) -> float:
    """How different two motions' velocities are [m/s]."""
    return length(difference(a.velocity, b.velocity)) + TURN_LENGTH_M * length(difference(a.rate, b.rate))

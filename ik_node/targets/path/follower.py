"""Follows paths: approach, start, time on the path, progress.

The path is a :class:`ik_node.targets.path.se3_spline.RigidSpline`; the reference reaches it by a
:mod:`ik_node.targets.transition`. A path starts in one of these ways:

* The arm is within ``JOIN_M`` and ``JOIN_RAD`` of the present pose of the path: it joins the path there, on time.
* Otherwise the arm moves straight and with the shortest turn to the first pose, and waits there for the start time.
* If the start time has passed when the arm arrives, the path starts late and stays late; no part of it is skipped.

A path that moves at its begin, or that is joined by an arm at rest, starts with a speed ramp over ``RAMP_S``, so that
the arm stays on its geometry; a path that moves at its end stops with such a ramp. Each ramp delays it by half of
``RAMP_S``.

Time on the path advances as the arm does: ``time_rate`` is the fraction s of the last twist that the limits allow. So
the arm stays on the geometry of the path, and everything after comes later.
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
from ik_node.targets.bounds import APPROACH, motion_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.path.foresight import PathForesight, PathPrediction, is_foreseen, viable_rate
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
"""An approach is completed when it is this close."""
MOVING_M_S, MOVING_RAD_S = 1e-3, 5e-3
"""Speeds above which a motion is not at rest."""
RAMP_S = 0.5
"""Duration of a speed ramp."""
TURN_LENGTH_M = 0.3
"""Length that converts angular to linear speeds in the comparison of velocities."""
LONGEST_GAP_S = 0.25
"""Longest gap between control steps that is made up for."""


@dataclass
class PathSnapshot:
    """State of :class:`PathFollower`; all values are immutable, so a shallow copy is a snapshot."""

    time_ns: int = 0
    knots: Knots | None = None
    time_scaling: TimeScalingTable | None = None
    search: JointSearch | None = None
    """Unfinished computation of times for a path without time stamps."""
    begin_ns: int | None = None
    transition: Transition | None = None
    ramp: SpeedRamp = field(default_factory=SpeedRamp)
    clock_s: float | None = None
    """Time since the start of the path; None before."""
    time_rate: float = 1.0
    prediction: PathPrediction | None = None
    """Joint motion ahead; None if it is not known."""
    foreseen_rate: float = 1.0
    """Rate of the time on the path that the joints can follow."""
    distance_m: float = nan


class PathFollower:
    """Follows one path after another; times are monotonic nanoseconds."""

    def __init__(self, settings: Settings, robot: Robot | None = None) -> None:
        """``robot``: its joint limits bound the speed along paths without time stamps; None to ignore them."""
        self._timing = PathTiming(settings, robot)
        self._foresight = None if robot is None else PathForesight(robot, settings)
        self.configure(settings)
        self._state = PathSnapshot()
        self._timed: TimedPath | None = None

    def configure(self, settings: Settings) -> None:
        """Applies other settings."""
        self._timing.configure(settings)
        if self._foresight is not None:
            self._foresight.configure(settings)
        self._limits = motion_bounds(settings.target, APPROACH)

    def capture(self) -> PathSnapshot:
        """A snapshot for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: PathSnapshot) -> None:
        """Continues from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._timed = None if snapshot.knots is None else TimedPath(snapshot.knots, snapshot.time_scaling)

    def forget(self) -> None:
        """Discards the path."""
        self._state, self._timed = PathSnapshot(), None

    # --- start --------------------------------------------------------------------------------------------------------

    def begin(self, request: PathRequest, reference: RigidMotion, time_ns: int, q: Array | None = None) -> None:
        """Starts a path.

        Args:
            request: The path.
            reference: Present reference motion.
            time_ns: Its monotonic time.
            q: Joint positions (n,); None if the joint limits are to be ignored.
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
        """Sets the time scaling, after a completed search."""
        s = self._state
        if s.knots is not None:
            s.time_scaling = self._timing.time_scaling(self._path.spline, s.search)
            s.search = None
            self._timed = TimedPath(s.knots, s.time_scaling)
            self._set_ramp(0.0, False)

    def rest_at(self, reference: RigidMotion, time_ns: int) -> None:
        """Continues with the path from rest elsewhere: returns to the point where it was left first."""
        s = self._state
        left_s = self._path_time(s.clock_s)
        s.time_ns, s.time_rate, s.clock_s = time_ns, 1.0, None
        self._set_ramp(left_s, is_moving(self._path.motion(left_s)))
        s.transition = start_transition(reference, self._goal(), self._limits)

    def move_to(self, reference: RigidMotion) -> None:
        """Continues on the path with a transition from another motion."""
        self._state.transition = start_transition(reference, self._goal(), self._limits)

    def _is_joinable(self) -> bool:
        transition = self._state.transition
        return transition is None or is_near(transition, JOIN_M, JOIN_RAD)

    def _join(self, reference: RigidMotion, entry_s: float) -> None:
        """Joins a path that has begun: at full speed or with a ramp, whichever is closer to ``reference``."""
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

    # --- control steps ------------------------------------------------------------------------------------------------

    def advance(
        self,
        time_ns: int,
        hold_s: float,
        time_rate: float = 1.0,
        pose_sb: Array | None = None,
        q: Array | None = None,
    ) -> Motion:
        """The desired motion at a control step.

        The twist belongs to the way on the path that the arm covers at ``time_rate``, so that arcs are not cut short.

        Args:
            time_ns: Monotonic time of the step.
            hold_s: Time for which the twist will be applied.
            time_rate: Fraction of the last twist that the arm executed.
            pose_sb: Measured T_sb (4, 4), for the distance from the path; None for no update.
            q: Measured joint positions (n,), for the foresight; None for none.

        Returns:
            T_sd at ``time_ns`` and its mean body twist V_d over ``hold_s``.
        """
        self._catch_up(time_ns, time_rate)
        s, path = self._state, self._path
        part = expected_time_rate(time_rate)
        begin = self._path_time(s.clock_s)
        self._foresee(begin, hold_s, q)
        end = self._path_time(self._clock_after(part * s.foreseen_rate * hold_s))
        motion, s.transition, distance_m = path.advance(begin, end, hold_s, s.transition, pose_sb, part)
        if pose_sb is not None:
            s.distance_m = distance_m
        return motion

    def _foresee(self, time_s: float, hold_s: float, q: Array | None) -> None:
        """Updates the prediction and the rate of the next ``hold_s``."""
        s, path = self._state, self._path
        if self._foresight is None or q is None or s.clock_s is None:
            s.prediction, s.foreseen_rate = None, 1.0
            return
        if s.prediction is None:
            s.foreseen_rate = 1.0
        s.prediction = self._foresight.updated(s.prediction, path.table, path.end_s, time_s, q)
        if s.prediction is None:
            s.foreseen_rate = 1.0
        else:
            # An arm that limits have slowed down speeds up again from its own rate, not from the one foreseen for it.
            s.foreseen_rate = viable_rate(s.prediction, time_s, hold_s, s.foreseen_rate * s.time_rate)

    def _catch_up(self, time_ns: int, time_rate: float) -> None:
        s = self._state
        before_ns, elapsed_s = s.time_ns, min(max((time_ns - s.time_ns) / NS, 0.0), LONGEST_GAP_S)
        s.time_rate = time_rate
        if s.transition is not None:
            s.transition = advanced(s.transition, elapsed_s, time_rate)
        s.time_ns = max(s.time_ns, time_ns)
        if s.clock_s is not None:
            s.clock_s += s.foreseen_rate * time_rate * elapsed_s
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
        """The reference at the last control step, slowed down as the arm is."""
        s = self._state
        return slowed(composed(self._goal(), s.transition), s.foreseen_rate * s.time_rate, 0.0)

    def _goal(self) -> RigidMotion:
        """The present motion on the path."""
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

    # --- status -------------------------------------------------------------------------------------------------------

    def reason(self, name: str) -> str:
        """Status text for a path of this name."""
        if self.finished:
            return f"{name} has ended; holding its last pose"
        if self.timing:
            return f"computing times for {name}"
        if self.waiting:
            return f"waiting for the start time of {name}" if self.early else f"moving to {name}"
        return f"following {name}"

    @property
    def waiting(self) -> bool:
        """True before the start of the path: the arm approaches it or waits for its start time."""
        return self._state.clock_s is None

    @property
    def timing(self) -> bool:
        """True while times for the path are computed."""
        return self._state.search is not None

    @property
    def early(self) -> bool:
        """True if the arm waits at the first pose."""
        s = self._state
        return s.clock_s is None and (s.transition is None or is_near(s.transition, ARRIVED_M, ARRIVED_RAD))

    @property
    def finished(self) -> bool:
        """True at the end of the path."""
        s = self._state
        return s.clock_s is not None and s.clock_s >= s.ramp.duration_s

    @property
    def foreseen(self) -> bool:
        """True if the joint motion ahead is known, and the rate of the path one that the joints can follow."""
        s = self._state
        return s.prediction is not None and is_foreseen(s.prediction, self._path_time(s.clock_s))

    @property
    def progress(self) -> float:
        """Elapsed fraction of the time on the path, 0 to 1."""
        return self._path_time(self._state.clock_s) / self._path.end_s

    @property
    def late_s(self) -> float:
        """Delay of the path behind its stamps [s]; 0 for a path without a start time."""
        s = self._state
        if s.begin_ns is None or self.finished:
            return 0.0
        return max((s.time_ns - s.begin_ns) / NS - self._path_time(s.clock_s), 0.0)

    @property
    def distance_m(self) -> float:
        """Distance of the tool point from the path [m]; NaN if unknown."""
        return self._state.distance_m

    @property
    def goal_sd(self) -> Array:
        """Last pose of the path (4, 4)."""
        return pose_matrix(self._path.resting(self._path.end_s))


def is_moving(motion: RigidMotion) -> bool:
    """True if the motion is not at rest."""
    return length(motion.velocity) > MOVING_M_S or length(motion.rate) > MOVING_RAD_S


def _jump(a: RigidMotion, b: RigidMotion) -> float:
    """Difference of the velocities of two motions [m/s]."""
    return length(difference(a.velocity, b.velocity)) + TURN_LENGTH_M * length(difference(a.rate, b.rate))

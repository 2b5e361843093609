"""The motion that pursues a streamed target: what every tick computes, as one compiled function.

``stream.py`` says from the samples what course the target takes; here the motion is led to it by the cascade of
``reference.py``. While samples come the goal runs along the curve; when they stop it comes to rest a little further,
and goes back to the last sample once the stream has ended.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.quaternion import IDENTITY, ZERO, Quaternion, Vector, difference, length
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import (
    Bounds,
    Jerk,
    RigidMotion,
    chase,
    mean_twist,
    move,
    orientation_error,
    pose_of,
)
from ik_node.targets.jerk_schedule import LONGEST_STEP_S, NOTHING_PLANNED, carried_out, empty_plan, write_jerk
from ik_node.targets.stream.extrapolation import Curve, Moment, evaluate, resting
from ik_node.targets.stream.latency import Latency, lag_at

LONGEST_CATCH_UP_S = 0.25
"""The motion makes up for missed ticks over at most this time; beyond, it goes on from where it is."""
SHORTEST_GAP_PERIOD_S = 0.02
"""Gaps are judged as if the period were at least this: fast streams are held up by networks for several periods."""
BRIDGE_PERIODS = 2.25
"""Silence for so many periods changes nothing: one lost sample. Over the next period the motion comes to rest."""
BLEND_PERIODS = 8.0
"""Over so many periods the motion comes back from where it was extrapolated to, to the last sample."""
ARRIVED_M, ARRIVED_RAD = 5e-3, 2e-2
"""A jump is over when the motion is this near to the target."""


class Sample(NamedTuple):
    """A pose of the stream that is used."""

    time_ns: int
    """Its stamp, on the monotonic clock."""
    received_ns: int
    position: Vector
    orientation: Quaternion


class Course(NamedTuple):
    """Where a target is and will be, by its samples."""

    newest: Sample
    curve: Curve
    linear_latency: Latency
    angular_latency: Latency
    period_s: float


class Pace(NamedTuple):
    """How a target is pursued."""

    linear: Bounds
    angular: Bounds
    bandwidth: float
    """Triple pole of the cascade, times the sample period."""
    max_bandwidth: float
    """The same at most [1/s]."""
    timeout_s: float
    """A stream that has been silent for so long has ended."""


class Chase(NamedTuple):
    """What the motion remembers from tick to tick, as compiled code works with it."""

    time_ns: int
    motion: RigidMotion
    plan: Array
    """From ``time_ns`` on, as :mod:`ik_node.targets.jerk_schedule` says."""
    hold_s: float
    """For how long the last twist was to hold."""
    turn: Vector
    """Last orientation error [rad]."""
    jumped: bool
    """The target has jumped, and the motion is on its way to it."""


class Pursuit(NamedTuple):
    """The same from tick to tick: 2.4 us of a tick as arrays, 4.7 us as nested tuples."""

    time_ns: int
    numbers: Array
    """(24,): of a :class:`Chase` position, velocity, acceleration, orientation, rate, angular acceleration, hold, turn
    and 1 if it has jumped."""
    plan: Array

    @property
    def motion(self) -> RigidMotion:
        """The reference at ``time_ns``."""
        return _chase(self.time_ns, self.numbers, self.plan).motion

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return bool(self.numbers[_JUMPED])


_HOLD, _TURN, _JUMPED = 19, 20, 23


def pursuit_from(motion: RigidMotion, time_ns: int) -> Pursuit:
    """At ``time_ns`` with nothing planned, on the way to nowhere."""
    return Pursuit(time_ns, _numbers(Chase(time_ns, motion, NOTHING_PLANNED, 0.0, ZERO, False)), NOTHING_PLANNED)


def elsewhere(pursuit: Pursuit, motion: RigidMotion, time_ns: int) -> Pursuit:
    """The same pursuit from another place."""
    chase = _chase(pursuit.time_ns, pursuit.numbers, pursuit.plan)._replace(motion=motion)
    return Pursuit(time_ns, _numbers(chase), NOTHING_PLANNED)


def after_a_jump(pursuit: Pursuit) -> Pursuit:
    """The same pursuit of a target that has jumped."""
    numbers = pursuit.numbers.copy()
    numbers[_JUMPED] = 1.0
    return pursuit._replace(numbers=numbers)


@compiled
def _chase(time_ns: int, x: Array, plan: Array) -> Chase:
    motion = RigidMotion(_vector(x, 0), _vector(x, 3), _vector(x, 6), _quaternion(x, 9), _vector(x, 13), _vector(x, 16))
    return Chase(time_ns, motion, plan, x[_HOLD], _vector(x, _TURN), x[_JUMPED] != 0.0)


@compiled
def _numbers(chase: Chase) -> Array:
    motion, x = chase.motion, np.empty(24)
    for axis in range(3):
        x[axis], x[3 + axis], x[6 + axis] = motion.position[axis], motion.velocity[axis], motion.acceleration[axis]
        x[13 + axis], x[16 + axis] = motion.rate[axis], motion.angular_acceleration[axis]
        x[_TURN + axis] = chase.turn[axis]
    for part in range(4):
        x[9 + part] = motion.orientation[part]
    x[_HOLD], x[_JUMPED] = chase.hold_s, 1.0 if chase.jumped else 0.0
    return x


NOWHERE = Course(
    Sample(0, 0, ZERO, IDENTITY), Curve(0, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, IDENTITY), Latency(), Latency(), 1.0
)
"""Stands in for the course before the first sample."""


class Packed(NamedTuple):
    """A course and a pace as two arrays: handing these to compiled code takes a tenth of what the tuples take."""

    times_ns: NDArray[np.int64]
    numbers: Array


def packed(course: Course, pace: Pace) -> Packed:
    """For :func:`pursued`; made anew with every sample, used at every tick."""
    newest, curve, linear, angular = course.newest, course.curve, course.linear_latency, course.angular_latency
    times_ns = newest.time_ns, newest.received_ns, curve.time_ns, linear.time_ns, angular.time_ns
    numbers = np.array(
        (
            *newest.position,
            *newest.orientation,
            *curve.position,
            *curve.velocity,
            *curve.acceleration,
            *curve.turn,
            *curve.rate,
            *curve.bend,
            *curve.orientation,
            *(linear.value_s, linear.goal_s, angular.value_s, angular.goal_s, course.period_s),
            *pace.linear,
            *pace.angular,
            *(pace.bandwidth, pace.max_bandwidth, pace.timeout_s),
        )
    )
    return Packed(np.array(times_ns, dtype=np.int64), numbers)


@compiled
def _unpacked(times_ns: NDArray[np.int64], x: Array) -> tuple[Course, Pace]:
    newest = Sample(times_ns[0], times_ns[1], _vector(x, 0), _quaternion(x, 3))
    curve = Curve(
        times_ns[2],
        _vector(x, 7),
        _vector(x, 10),
        _vector(x, 13),
        _vector(x, 16),
        _vector(x, 19),
        _vector(x, 22),
        _quaternion(x, 25),
    )
    linear, angular = Latency(x[29], x[30], times_ns[3]), Latency(x[31], x[32], times_ns[4])
    pace = Pace(Bounds(x[34], x[35], x[36], x[37]), Bounds(x[38], x[39], x[40], x[41]), x[42], x[43], x[44])
    return Course(newest, curve, linear, angular, x[33]), pace


@compiled
def _vector(numbers: Array, first: int) -> Vector:
    return (numbers[first], numbers[first + 1], numbers[first + 2])


@compiled
def _quaternion(numbers: Array, first: int) -> Quaternion:
    return (numbers[first], numbers[first + 1], numbers[first + 2], numbers[first + 3])


@compiled
def gap_period_s(period_s: float) -> float:
    """The period by which gaps between samples are judged."""
    return max(period_s, SHORTEST_GAP_PERIOD_S)


@compiled
def pursued(
    before_ns: int,
    before: Array,
    plan: Array,
    times_ns: NDArray[np.int64],
    numbers: Array,
    follows: bool,
    time_ns: int,
    hold_s: float,
) -> tuple[int, Array, Array, Array, Array]:
    """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow, with what is to be remembered.

    ``before_ns``, ``before``, ``plan``: :class:`Pursuit`; ``times_ns`` and ``numbers``: :class:`Packed`. Unless it
    ``follows`` the course it comes to rest. Time never runs backwards: an earlier ``time_ns`` gives the present state
    again. Returns a Pursuit's parts, pose (4, 4) and twist (6,) of a Motion.
    """
    course, pace = _unpacked(times_ns, numbers)
    now = _caught_up(_chase(before_ns, before, plan), course, follows, pace, time_ns)
    then = Chase(now.time_ns, now.motion, now.plan, hold_s, now.turn, now.jumped)
    new_plan = empty_plan(hold_s)
    for step, row in enumerate(new_plan):
        then, jerk = _stepped(then, course, follows, pace, now.time_ns + round(step * row[6] * NS), row[6])
        write_jerk(row, jerk)
    after = Chase(now.time_ns, now.motion, new_plan, hold_s, then.turn, then.jumped)
    return now.time_ns, _numbers(after), new_plan, pose_of(now.motion), mean_twist(now.motion, then.motion, hold_s)


@compiled
def _caught_up(before: Chase, course: Course, follows: bool, pace: Pace, time_ns: int) -> Chase:
    """At ``time_ns``: as planned first, and where the tick is late, on from there."""
    if time_ns <= before.time_ns:
        return before
    elapsed_s = min((time_ns - before.time_ns) / NS, LONGEST_CATCH_UP_S)
    motion, left_s = carried_out(before.motion, before.plan, elapsed_s)
    now = Chase(before.time_ns, motion, before.plan, before.hold_s, before.turn, before.jumped)
    while left_s > 1e-9:
        part_s = min(LONGEST_STEP_S, left_s)
        now, _ = _stepped(now, course, follows, pace, time_ns - round(left_s * NS), part_s)
        left_s -= part_s
    return Chase(time_ns, now.motion, now.plan, now.hold_s, now.turn, now.jumped)


@compiled
def _stepped(now: Chase, course: Course, follows: bool, pace: Pace, time_ns: int, step_s: float) -> tuple[Chase, Jerk]:
    """One step of the cascade, from where the motion is at ``time_ns``; and its jerk."""
    motion = now.motion
    omega = min(pace.bandwidth / course.period_s, pace.max_bandwidth)
    goal, way, turn, jumped = resting(motion.position, motion.orientation), ZERO, ZERO, now.jumped
    if follows:
        goal = _goal(course, pace.timeout_s, now.hold_s, time_ns)
        way = difference(goal.position, motion.position)
        turn = orientation_error(goal.orientation, motion.orientation, now.turn)
        jumped = jumped and not (length(way) < ARRIVED_M and length(turn) < ARRIVED_RAD)
    linear = chase(
        way, motion.velocity, motion.acceleration, goal.velocity, goal.acceleration, omega, pace.linear, step_s
    )
    angular = chase(
        turn,
        motion.rate,
        motion.angular_acceleration,
        goal.rate,
        goal.angular_acceleration,
        omega,
        pace.angular,
        step_s,
    )
    jerk = Jerk(linear, angular, step_s)
    return Chase(now.time_ns, move(motion, jerk, step_s), now.plan, now.hold_s, turn, jumped), jerk


@compiled
def _goal(course: Course, timeout_s: float, hold_s: float, time_ns: int) -> RigidMotion:
    """Where the target is now: along the curve while samples come, at rest a little further when they stop."""
    newest, period_s = course.newest, gap_period_s(course.period_s)
    age_s = (time_ns - course.curve.time_ns) / NS
    silent_s = (time_ns - newest.received_ns) / NS
    pace, change, back = 1.0, 0.0, 1.0
    over_s = silent_s - BRIDGE_PERIODS * period_s - hold_s  # what arrives meanwhile is seen at the next tick
    if over_s > 0.0:
        if over_s < period_s:
            age_s -= 0.5 * over_s * over_s / period_s
            pace, change = 1.0 - over_s / period_s, -1.0 / period_s
        else:
            age_s -= over_s - 0.5 * period_s
            pace = 0.0
        left = 1.0 - (silent_s - timeout_s) / (BLEND_PERIODS * period_s)
        if left <= 0.0:
            return resting(newest.position, newest.orientation)
        if left < 1.0:
            back = left * left * (3.0 - 2.0 * left)
    linear_s, linear_rate = lag_at(course.linear_latency, time_ns)
    angular_s, angular_rate = lag_at(course.angular_latency, time_ns)
    return evaluate(
        course.curve,
        Moment(back * (age_s - linear_s), pace * (1.0 - linear_rate), change),
        Moment(back * (age_s - angular_s), pace * (1.0 - angular_rate), change),
    )

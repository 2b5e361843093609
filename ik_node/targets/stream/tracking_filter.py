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
from ik_node.math.numerics import smoothstep
from ik_node.math.quaternion import IDENTITY, ZERO, Quaternion, Vector, difference, length
from ik_node.math.types import Array
from ik_node.targets.jerk_limited_filter import (
    Bounds,
    Jerk,
    RigidMotion,
    cascade_jerk,
    integrate,
    mean_twist,
    orientation_error,
    pose_matrix,
)
from ik_node.targets.jerk_schedule import EMPTY_SCHEDULE, LONGEST_STEP_S, empty_schedule, executed, write_jerk
from ik_node.targets.stream.extrapolation import CurveParameter, TargetCurve, evaluate, resting
from ik_node.targets.stream.latency import Latency, latency_at

BANDWIDTH = 3.5
"""Triple pole of the cascade [rad/s] times the sample period [s]; a larger one follows closer, a smaller one smooths."""
MAX_BANDWIDTH = 65.0
"""Largest triple pole [rad/s], for fast streams."""
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


class StreamSample(NamedTuple):
    """A pose of the stream that is used."""

    time_ns: int
    """Its stamp, on the monotonic clock."""
    received_ns: int
    position: Vector
    orientation: Quaternion


class TargetPrediction(NamedTuple):
    """Where a target is and will be, by its samples."""

    newest: StreamSample
    curve: TargetCurve
    linear_latency: Latency
    angular_latency: Latency
    period_s: float


class TrackingBounds(NamedTuple):
    """How a target is pursued."""

    linear: Bounds
    angular: Bounds
    timeout_s: float
    """A stream that has been silent for so long has ended."""


class FilterState(NamedTuple):
    """What the motion remembers from tick to tick, as compiled code works with it."""

    time_ns: int
    motion: RigidMotion
    schedule: Array
    """From ``time_ns`` on, as :mod:`ik_node.targets.jerk_schedule` says."""
    hold_s: float
    """For how long the last twist was to hold."""
    turn: Vector
    """Last orientation error [rad]."""
    jumped: bool
    """The target has jumped, and the motion is on its way to it."""


class PackedFilterState(NamedTuple):
    """The same from tick to tick: 2.4 us of a tick as arrays, 4.7 us as nested tuples."""

    time_ns: int
    numbers: Array
    """(24,): of a :class:`FilterState` position, velocity, acceleration, orientation, rate, angular acceleration, hold, turn
    and 1 if it has jumped."""
    schedule: Array

    @property
    def motion(self) -> RigidMotion:
        """The reference at ``time_ns``."""
        return _state(self.time_ns, self.numbers, self.schedule).motion

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return bool(self.numbers[_JUMPED])


_HOLD, _TURN, _JUMPED = 19, 20, 23


def filter_state_from(motion: RigidMotion, time_ns: int) -> PackedFilterState:
    """At ``time_ns`` with nothing planned, on the way to nowhere."""
    return PackedFilterState(
        time_ns, _numbers(FilterState(time_ns, motion, EMPTY_SCHEDULE, 0.0, ZERO, False)), EMPTY_SCHEDULE
    )


def moved_to(filter_state: PackedFilterState, motion: RigidMotion, time_ns: int) -> PackedFilterState:
    """The same pursuit from another place."""
    cascade_jerk = _state(filter_state.time_ns, filter_state.numbers, filter_state.schedule)._replace(motion=motion)
    return PackedFilterState(time_ns, _numbers(cascade_jerk), EMPTY_SCHEDULE)


def after_a_jump(filter_state: PackedFilterState) -> PackedFilterState:
    """The same pursuit of a target that has jumped."""
    numbers = filter_state.numbers.copy()
    numbers[_JUMPED] = 1.0
    return filter_state._replace(numbers=numbers)


@compiled
def _state(time_ns: int, x: Array, schedule: Array) -> FilterState:
    motion = RigidMotion(_vector(x, 0), _vector(x, 3), _vector(x, 6), _quaternion(x, 9), _vector(x, 13), _vector(x, 16))
    return FilterState(time_ns, motion, schedule, x[_HOLD], _vector(x, _TURN), x[_JUMPED] != 0.0)


@compiled
def _numbers(cascade_jerk: FilterState) -> Array:
    motion, x = cascade_jerk.motion, np.empty(24)
    for axis in range(3):
        x[axis], x[3 + axis], x[6 + axis] = motion.position[axis], motion.velocity[axis], motion.acceleration[axis]
        x[13 + axis], x[16 + axis] = motion.rate[axis], motion.angular_acceleration[axis]
        x[_TURN + axis] = cascade_jerk.turn[axis]
    for part in range(4):
        x[9 + part] = motion.orientation[part]
    x[_HOLD], x[_JUMPED] = cascade_jerk.hold_s, 1.0 if cascade_jerk.jumped else 0.0
    return x


NO_PREDICTION = TargetPrediction(
    StreamSample(0, 0, ZERO, IDENTITY),
    TargetCurve(0, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, IDENTITY),
    Latency(),
    Latency(),
    1.0,
)
"""Stands in for the course before the first sample."""


class PredictionArrays(NamedTuple):
    """A course and a pace as two arrays: handing these to compiled code takes a tenth of what the tuples take."""

    times_ns: NDArray[np.int64]
    numbers: Array


def as_arrays(prediction: TargetPrediction, bounds: TrackingBounds) -> PredictionArrays:
    """For :func:`advanced_filter`; made anew with every sample, used at every tick."""
    newest, curve, linear, angular = (
        prediction.newest,
        prediction.curve,
        prediction.linear_latency,
        prediction.angular_latency,
    )
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
            *(linear.value_s, linear.goal_s, angular.value_s, angular.goal_s, prediction.period_s),
            *bounds.linear,
            *bounds.angular,
            bounds.timeout_s,
        )
    )
    return PredictionArrays(np.array(times_ns, dtype=np.int64), numbers)


@compiled
def _from_arrays(times_ns: NDArray[np.int64], x: Array) -> tuple[TargetPrediction, TrackingBounds]:
    newest = StreamSample(times_ns[0], times_ns[1], _vector(x, 0), _quaternion(x, 3))
    curve = TargetCurve(
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
    bounds = TrackingBounds(Bounds(x[34], x[35], x[36], x[37]), Bounds(x[38], x[39], x[40], x[41]), x[42])
    return TargetPrediction(newest, curve, linear, angular, x[33]), bounds


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
def advanced_filter(
    before_ns: int,
    before: Array,
    schedule: Array,
    times_ns: NDArray[np.int64],
    numbers: Array,
    follows: bool,
    time_ns: int,
    hold_s: float,
) -> tuple[int, Array, Array, Array, Array]:
    """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow, with what is to be remembered.

    ``before_ns``, ``before``, ``schedule``: :class:`PackedFilterState`; ``times_ns`` and ``numbers``: :class:`PredictionArrays`. Unless it
    ``follows`` the course it comes to rest. Time never runs backwards: an earlier ``time_ns`` gives the present state
    again. Returns a Pursuit's parts, pose (4, 4) and twist (6,) of a Motion.
    """
    prediction, bounds = _from_arrays(times_ns, numbers)
    now = _caught_up(_state(before_ns, before, schedule), prediction, follows, bounds, time_ns)
    then = FilterState(now.time_ns, now.motion, now.schedule, hold_s, now.turn, now.jumped)
    new_plan = empty_schedule(hold_s)
    for step, row in enumerate(new_plan):
        then, jerk = _stepped(then, prediction, follows, bounds, now.time_ns + round(step * row[6] * NS), row[6])
        write_jerk(row, jerk)
    after = FilterState(now.time_ns, now.motion, new_plan, hold_s, then.turn, then.jumped)
    return now.time_ns, _numbers(after), new_plan, pose_matrix(now.motion), mean_twist(now.motion, then.motion, hold_s)


@compiled
def _caught_up(
    before: FilterState, prediction: TargetPrediction, follows: bool, bounds: TrackingBounds, time_ns: int
) -> FilterState:
    """At ``time_ns``: as planned first, and where the tick is late, on from there."""
    if time_ns <= before.time_ns:
        return before
    elapsed_s = min((time_ns - before.time_ns) / NS, LONGEST_CATCH_UP_S)
    motion, left_s = executed(before.motion, before.schedule, elapsed_s)
    now = FilterState(before.time_ns, motion, before.schedule, before.hold_s, before.turn, before.jumped)
    while left_s > 1e-9:
        part_s = min(LONGEST_STEP_S, left_s)
        now, _ = _stepped(now, prediction, follows, bounds, time_ns - round(left_s * NS), part_s)
        left_s -= part_s
    return FilterState(time_ns, now.motion, now.schedule, now.hold_s, now.turn, now.jumped)


@compiled
def _stepped(
    now: FilterState, prediction: TargetPrediction, follows: bool, bounds: TrackingBounds, time_ns: int, step_s: float
) -> tuple[FilterState, Jerk]:
    """One step of the cascade, from where the motion is at ``time_ns``; and its jerk."""
    motion = now.motion
    omega = min(BANDWIDTH / prediction.period_s, MAX_BANDWIDTH)
    goal, way, turn, jumped = resting(motion.position, motion.orientation), ZERO, ZERO, now.jumped
    if follows:
        goal = _goal(prediction, bounds.timeout_s, now.hold_s, time_ns)
        way = difference(goal.position, motion.position)
        turn = orientation_error(goal.orientation, motion.orientation, now.turn)
        jumped = jumped and not (length(way) < ARRIVED_M and length(turn) < ARRIVED_RAD)
    linear = cascade_jerk(
        way, motion.velocity, motion.acceleration, goal.velocity, goal.acceleration, omega, bounds.linear, step_s
    )
    angular = cascade_jerk(
        turn,
        motion.rate,
        motion.angular_acceleration,
        goal.rate,
        goal.angular_acceleration,
        omega,
        bounds.angular,
        step_s,
    )
    jerk = Jerk(linear, angular, step_s)
    return FilterState(now.time_ns, integrate(motion, jerk, step_s), now.schedule, now.hold_s, turn, jumped), jerk


@compiled
def _goal(prediction: TargetPrediction, timeout_s: float, hold_s: float, time_ns: int) -> RigidMotion:
    """Where the target is now: along the curve while samples come, at rest a little further when they stop."""
    newest, period_s = prediction.newest, gap_period_s(prediction.period_s)
    age_s = (time_ns - prediction.curve.time_ns) / NS
    silent_s = (time_ns - newest.received_ns) / NS
    time_rate, change, back = 1.0, 0.0, 1.0
    over_s = silent_s - BRIDGE_PERIODS * period_s - hold_s  # what arrives meanwhile is seen at the next tick
    if over_s > 0.0:
        if over_s < period_s:
            age_s -= 0.5 * over_s * over_s / period_s
            time_rate, change = 1.0 - over_s / period_s, -1.0 / period_s
        else:
            age_s -= over_s - 0.5 * period_s
            time_rate = 0.0
        left = 1.0 - (silent_s - timeout_s) / (BLEND_PERIODS * period_s)
        if left <= 0.0:
            return resting(newest.position, newest.orientation)
        if left < 1.0:
            back = smoothstep(left)
    linear_s, linear_rate = latency_at(prediction.linear_latency, time_ns)
    angular_s, angular_rate = latency_at(prediction.angular_latency, time_ns)
    return evaluate(
        prediction.curve,
        CurveParameter(back * (age_s - linear_s), time_rate * (1.0 - linear_rate), change),
        CurveParameter(back * (age_s - angular_s), time_rate * (1.0 - angular_rate), change),
    )

"""Tracking filter: leads the reference motion to the target of a stream, one compiled call per control step.

The desired pose and the desired twist between two samples of a stream come from here. ``stream.py`` derives a
:class:`TargetPrediction` from the samples; :func:`advanced_filter` evaluates it at the time of the control step and
leads the motion to it with the cascade of :mod:`ik_node.targets.jerk_limited_filter`. While samples arrive, the goal
moves along the predicted curve. When they stop, the goal comes to rest a little further on, and returns to the last
sample once the stream has ended.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
from ik_node.targets.stream.cascade_gains import cascade_gains
from ik_node.targets.stream.extrapolation import CurveParameter, TargetCurve, evaluate, resting
from ik_node.targets.stream.latency import Latency, latency_at

LONGEST_CATCH_UP_S = 0.25
"""Missed control steps are made up for over at most this time; a longer gap is skipped."""
SHORTEST_GAP_PERIOD_S = 0.02
"""Smallest period for the evaluation of gaps: networks delay fast streams by several periods."""
BRIDGE_PERIODS = 2.25
"""A gap of up to this many periods (one lost sample) changes nothing. Over the next period the goal comes to rest."""
BLEND_PERIODS = 8.0
"""Number of periods over which the goal returns from the extrapolated pose to the last sample."""
ARRIVED_M, ARRIVED_RAD = 5e-3, 2e-2
"""A jump is completed when the motion is this close to the target."""


class StreamSample(NamedTuple):
    """An accepted pose of the stream."""

    time_ns: int
    """Its stamp, on the monotonic clock."""
    received_ns: int
    position: Vector
    orientation: Quaternion


class TargetPrediction(NamedTuple):
    """The target's motion as predicted from its samples."""

    newest: StreamSample
    curve: TargetCurve
    linear_latency: Latency
    angular_latency: Latency
    period_s: float


class TrackingBounds(NamedTuple):
    """Bounds of the filter."""

    linear: Bounds
    angular: Bounds
    timeout_s: float
    """A stream without samples for this long has ended."""


NO_PREDICTION = TargetPrediction(
    StreamSample(0, 0, ZERO, IDENTITY),
    TargetCurve(0, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, IDENTITY),
    Latency(),
    Latency(),
    1.0,
)
"""Placeholder before the first sample."""


# --- state ------------------------------------------------------------------------------------------------------------


class FilterState(NamedTuple):
    """State between control steps, as the compiled code uses it."""

    time_ns: int
    motion: RigidMotion
    schedule: Array
    """Jerks from ``time_ns`` on, see :mod:`ik_node.targets.jerk_schedule`."""
    hold_s: float
    """Hold time of the last twist."""
    turn: Vector
    """Last orientation error [rad]."""
    jumped: bool
    """True from a jump of the target until the motion has arrived."""


class PackedFilterState(NamedTuple):
    """The same state in arrays, which cost 2.4 us per control step; nested tuples cost 4.7 us."""

    time_ns: int
    numbers: Array
    """(24,); the offsets of the fields of :class:`FilterState` are :data:`_POSITION` to :data:`_JUMPED`."""
    schedule: Array

    @property
    def motion(self) -> RigidMotion:
        """The reference at ``time_ns``."""
        return _unpacked_state(self.time_ns, self.numbers, self.schedule).motion

    @property
    def jumped(self) -> bool:
        """True from a jump of the target until the motion has arrived."""
        return bool(self.numbers[_JUMPED])


_POSITION, _VELOCITY, _ACCELERATION, _ORIENTATION, _RATE, _ANGULAR_ACCELERATION = 0, 3, 6, 9, 13, 16
_HOLD, _TURN, _JUMPED, _SIZE = 19, 20, 23, 24


def filter_state_from(motion: RigidMotion, time_ns: int) -> PackedFilterState:
    """The state with ``motion`` at ``time_ns`` and an empty schedule."""
    return PackedFilterState(
        time_ns, _packed_state(FilterState(time_ns, motion, EMPTY_SCHEDULE, 0.0, ZERO, False)), EMPTY_SCHEDULE
    )


def moved_to(filter_state: PackedFilterState, motion: RigidMotion, time_ns: int) -> PackedFilterState:
    """The state with another motion and an empty schedule."""
    state = _unpacked_state(filter_state.time_ns, filter_state.numbers, filter_state.schedule)
    return PackedFilterState(time_ns, _packed_state(state._replace(motion=motion)), EMPTY_SCHEDULE)


def after_a_jump(filter_state: PackedFilterState) -> PackedFilterState:
    """The state with the mark of a jump."""
    numbers = filter_state.numbers.copy()
    numbers[_JUMPED] = 1.0
    return filter_state._replace(numbers=numbers)


@compiled
def _unpacked_state(time_ns: int, x: Array, schedule: Array) -> FilterState:
    motion = RigidMotion(
        _vector(x, _POSITION),
        _vector(x, _VELOCITY),
        _vector(x, _ACCELERATION),
        _quaternion(x, _ORIENTATION),
        _vector(x, _RATE),
        _vector(x, _ANGULAR_ACCELERATION),
    )
    return FilterState(time_ns, motion, schedule, x[_HOLD], _vector(x, _TURN), x[_JUMPED] != 0.0)


@compiled
def _packed_state(state: FilterState) -> Array:
    motion, x = state.motion, np.empty(_SIZE)
    for axis in range(3):
        x[_POSITION + axis] = motion.position[axis]
        x[_VELOCITY + axis] = motion.velocity[axis]
        x[_ACCELERATION + axis] = motion.acceleration[axis]
        x[_RATE + axis] = motion.rate[axis]
        x[_ANGULAR_ACCELERATION + axis] = motion.angular_acceleration[axis]
        x[_TURN + axis] = state.turn[axis]
    for entry in range(4):
        x[_ORIENTATION + entry] = motion.orientation[entry]
    x[_HOLD], x[_JUMPED] = state.hold_s, 1.0 if state.jumped else 0.0
    return x


@compiled
def _vector(numbers: Array, first: int) -> Vector:
    return (numbers[first], numbers[first + 1], numbers[first + 2])


@compiled
def _quaternion(numbers: Array, first: int) -> Quaternion:
    return (numbers[first], numbers[first + 1], numbers[first + 2], numbers[first + 3])


# --- prediction and bounds as one record ------------------------------------------------------------------------------

INPUT_RECORD = np.dtype(
    [
        ("sample_time_ns", np.int64),
        ("sample_received_ns", np.int64),
        ("sample_position", np.float64, 3),
        ("sample_orientation", np.float64, 4),
        ("curve_time_ns", np.int64),
        ("curve_vectors", np.float64, 18),  # the six vectors of TargetCurve
        ("curve_orientation", np.float64, 4),
        ("latency_time_ns", np.int64, 2),  # [linear, angular]
        ("latency_value_s", np.float64, 2),
        ("latency_goal_s", np.float64, 2),
        ("period_s", np.float64),
        ("linear_bounds", np.float64, 4),
        ("angular_bounds", np.float64, 4),
        ("timeout_s", np.float64),
    ]
)
"""A :class:`TargetPrediction` and :class:`TrackingBounds`; passing this to compiled code takes a tenth of the time that
nested tuples take."""


def as_arrays(prediction: TargetPrediction, bounds: TrackingBounds) -> NDArray[Any]:
    """The array (1,) of :data:`INPUT_RECORD` for :func:`advanced_filter`; built once per sample."""
    newest, curve = prediction.newest, prediction.curve
    linear, angular = prediction.linear_latency, prediction.angular_latency
    vectors = (*curve.position, *curve.velocity, *curve.acceleration, *curve.turn, *curve.rate, *curve.bend)
    record = (
        newest.time_ns,
        newest.received_ns,
        newest.position,
        newest.orientation,
        curve.time_ns,
        vectors,
        curve.orientation,
        (linear.time_ns, angular.time_ns),
        (linear.value_s, angular.value_s),
        (linear.goal_s, angular.goal_s),
        prediction.period_s,
        tuple(bounds.linear),
        tuple(bounds.angular),
        bounds.timeout_s,
    )
    return np.array([record], dtype=INPUT_RECORD)


@compiled
def _from_arrays(inputs: NDArray[Any]) -> tuple[TargetPrediction, TrackingBounds]:
    record = inputs[0]
    newest = StreamSample(
        record.sample_time_ns,
        record.sample_received_ns,
        _vector(record.sample_position, 0),
        _quaternion(record.sample_orientation, 0),
    )
    vectors = record.curve_vectors
    curve = TargetCurve(
        record.curve_time_ns,
        _vector(vectors, 0),
        _vector(vectors, 3),
        _vector(vectors, 6),
        _vector(vectors, 9),
        _vector(vectors, 12),
        _vector(vectors, 15),
        _quaternion(record.curve_orientation, 0),
    )
    value_s, goal_s, time_ns = record.latency_value_s, record.latency_goal_s, record.latency_time_ns
    linear, angular = Latency(value_s[0], goal_s[0], time_ns[0]), Latency(value_s[1], goal_s[1], time_ns[1])
    bounds = TrackingBounds(_bounds(record.linear_bounds), _bounds(record.angular_bounds), record.timeout_s)
    return TargetPrediction(newest, curve, linear, angular, record.period_s), bounds


@compiled
def _bounds(numbers: Array) -> Bounds:
    return Bounds(numbers[0], numbers[1], numbers[2], numbers[3])


# --- one control step -------------------------------------------------------------------------------------------------


@compiled
def gap_period_s(period_s: float) -> float:
    """The period by which gaps between samples are evaluated."""
    return max(period_s, SHORTEST_GAP_PERIOD_S)


@compiled
def advanced_filter(
    before_ns: int,
    before: Array,
    schedule: Array,
    inputs: NDArray[Any],
    follows: bool,
    time_ns: int,
    hold_s: float,
) -> tuple[int, Array, Array, Array, Array]:
    """The reference at ``time_ns``, its mean twist over the following ``hold_s``, and the new state.

    Time never runs backwards: an earlier ``time_ns`` gives the present state again.

    Args:
        before_ns: Time of the state, first field of a :class:`PackedFilterState`.
        before: Numbers of the state, its second field.
        schedule: Scheduled jerks, its third field.
        inputs: Result of :func:`as_arrays`.
        follows: False to come to rest instead of following the prediction.
        time_ns: Monotonic time of the control step.
        hold_s: Time for which the twist will be applied.

    Returns:
        The three fields of the new :class:`PackedFilterState`, T_sd (4, 4), and the body twist (6,) of {d}.
    """
    prediction, bounds = _from_arrays(inputs)
    now = _caught_up(_unpacked_state(before_ns, before, schedule), prediction, follows, bounds, time_ns)
    then = FilterState(now.time_ns, now.motion, now.schedule, hold_s, now.turn, now.jumped)
    new_schedule = empty_schedule(hold_s)
    for step, row in enumerate(new_schedule):
        then, jerk = _stepped(then, prediction, follows, bounds, now.time_ns + round(step * row[6] * NS), row[6])
        write_jerk(row, jerk)
    after = FilterState(now.time_ns, now.motion, new_schedule, hold_s, then.turn, then.jumped)
    twist_d = mean_twist(now.motion, then.motion, hold_s)
    return now.time_ns, _packed_state(after), new_schedule, pose_matrix(now.motion), twist_d


@compiled
def _caught_up(
    before: FilterState, prediction: TargetPrediction, follows: bool, bounds: TrackingBounds, time_ns: int
) -> FilterState:
    """The state at ``time_ns``: first by the schedule, then by further steps if the control step is late."""
    if time_ns <= before.time_ns:
        return before
    elapsed_s = min((time_ns - before.time_ns) / NS, LONGEST_CATCH_UP_S)
    motion, left_s = executed(before.motion, before.schedule, elapsed_s)
    now = FilterState(before.time_ns, motion, before.schedule, before.hold_s, before.turn, before.jumped)
    while left_s > 1e-9:
        step_s = min(LONGEST_STEP_S, left_s)
        now, _ = _stepped(now, prediction, follows, bounds, time_ns - round(left_s * NS), step_s)
        left_s -= step_s
    return FilterState(time_ns, now.motion, now.schedule, now.hold_s, now.turn, now.jumped)


@compiled
def _stepped(
    now: FilterState, prediction: TargetPrediction, follows: bool, bounds: TrackingBounds, time_ns: int, step_s: float
) -> tuple[FilterState, Jerk]:
    """The state after one step of the cascade that begins at ``time_ns``, and the jerk of the step."""
    motion = now.motion
    linear_gain, linear_omega = cascade_gains(prediction.period_s, 0)
    angular_gain, angular_omega = cascade_gains(prediction.period_s, 1)
    goal, error, turn, jumped = resting(motion.position, motion.orientation), ZERO, ZERO, now.jumped
    if follows:
        goal = _goal(prediction, bounds.timeout_s, now.hold_s, time_ns)
        error = difference(goal.position, motion.position)
        turn = orientation_error(goal.orientation, motion.orientation, now.turn)
        jumped = jumped and not (length(error) < ARRIVED_M and length(turn) < ARRIVED_RAD)
    linear = cascade_jerk(
        error,
        motion.velocity,
        motion.acceleration,
        goal.velocity,
        goal.acceleration,
        linear_gain,
        linear_omega,
        bounds.linear,
        step_s,
    )
    angular = cascade_jerk(
        turn,
        motion.rate,
        motion.angular_acceleration,
        goal.rate,
        goal.angular_acceleration,
        angular_gain,
        angular_omega,
        bounds.angular,
        step_s,
    )
    jerk = Jerk(linear, angular, step_s)
    return FilterState(now.time_ns, integrate(motion, jerk, step_s), now.schedule, now.hold_s, turn, jumped), jerk


@compiled
def _goal(prediction: TargetPrediction, timeout_s: float, hold_s: float, time_ns: int) -> RigidMotion:
    """The target at ``time_ns``: on the curve while samples arrive, at rest a little further on when they stop."""
    newest, period_s = prediction.newest, gap_period_s(prediction.period_s)
    age_s = (time_ns - prediction.curve.time_ns) / NS
    silent_s = (time_ns - newest.received_ns) / NS
    time_rate, change, back = 1.0, 0.0, 1.0
    over_s = silent_s - BRIDGE_PERIODS * period_s - hold_s  # samples that arrive meanwhile count at the next step
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

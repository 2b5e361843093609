"""Streamed poses as a smooth motion.

Samples come when they come; the motion is asked for at every control tick. ``sampling_clock.py`` says when each sample was
taken, ``predictors.py`` where the target is now, and ``filter_state.py`` leads a motion with bounded speed, acceleration and
jerk to it. A target that is hard to foretell is followed a part of a sample period late: interpolation is better than
extrapolation then. How late follows from how wrong the predictions have been, so that a smooth target is followed
without lag.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import inf

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import Motion
from ik_node.math.quaternion import conjugate, difference, from_matrix, length, multiply, to_rotation_vector
from ik_node.math.types import Array
from ik_node.settings.groups import Pair, TargetSettings
from ik_node.targets.bounds import stream_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.stream.extrapolation import TargetCurve, resting
from ik_node.targets.stream.latency import Latency, latency_at, target_latency
from ik_node.targets.stream.predictors import PredictorBank, new_bank, updated_bank
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated
from ik_node.targets.stream.tracking_filter import (
    NO_PREDICTION,
    PackedFilterState,
    StreamSample,
    TargetPrediction,
    TrackingBounds,
    advanced_filter,
    after_a_jump,
    as_arrays,
    filter_state_from,
    gap_period_s,
    moved_to,
)

MAX_LATENCY_PERIODS: Pair = (0.9, 1.0)
"""Maximum smoothing delay [linear, angular] in sample periods, for unpredictable targets."""
LOST_PERIODS = 4.0
"""A gap longer than this many periods ends what the older samples say about the motion."""
LONGEST_TRANSPORT_S = 0.1
"""A target is extrapolated over the time that its samples take to arrive for at most this."""
SHORTEST_JUDGED_S = 0.01
"""Whether samples are a jump is judged as if they were at least this far apart: fast streams have noisy rates."""
REPEATED = 0.5
"""The same pose again within this part of a period is a duplicate, not a sample of a target at rest."""


@dataclass
class StreamSnapshot:
    """Everything that the motion remembers. Values are immutable, so that a shallow copy is a snapshot."""

    filter_state: PackedFilterState = field(default_factory=lambda: filter_state_from(RigidMotion(), 0))
    newest: StreamSample | None = None
    sampling_clock: SamplingClock = field(default_factory=SamplingClock)
    bank: PredictorBank | None = None
    curve: TargetCurve | None = None
    linear_latency: Latency = field(default_factory=Latency)
    angular_latency: Latency = field(default_factory=Latency)
    held: bool = False
    samples: int = 0
    duplicates: int = 0
    late: int = 0
    reordered: int = 0


class StreamedPoses:
    """Samples of a pose in, T_sd(t) and V_d(t) out. All times are monotonic nanoseconds."""

    def __init__(self, settings: TargetSettings, max_latency: Pair = MAX_LATENCY_PERIODS) -> None:
        """``max_latency``: maximum smoothing delay in sample periods [linear, angular]."""
        self._max_latency = max_latency
        self._state = StreamSnapshot()
        self.configure(settings)

    def configure(self, settings: TargetSettings) -> None:
        """Other settings from now on; what has been learnt of the stream stays."""
        self._pace = TrackingBounds(
            *stream_bounds(settings),
            settings.timeout_s,
        )
        self._update_arrays()

    def capture(self) -> StreamSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: StreamSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._update_arrays()

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd`` (4, 4); every sample and figure is forgotten."""
        x, y, z = pose_sd[:3, 3].tolist()
        self.take_over(resting((x, y, z), from_matrix(pose_sd)), time_ns)

    def take_over(self, motion: RigidMotion, time_ns: int) -> None:
        """As :meth:`start`, from where another reference is, and as it moves."""
        self._state = StreamSnapshot(filter_state_from(motion, time_ns))
        self._update_arrays()

    def rest_at(self, motion: RigidMotion, time_ns: int) -> None:
        """Goes on following the same samples from somewhere else."""
        self._state.filter_state = moved_to(self._state.filter_state, motion, time_ns)

    def hold(self) -> None:
        """Stops following: comes to rest within the bounds and stays there until :meth:`start`."""
        self._state.held = True

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """One checked pose (4, 4) of the stream."""
        s = self._state
        s.samples += 1
        x, y, z = pose_sd[:3, 3].tolist()
        sample = StreamSample(stamped.time_ns, stamped.received_ns, (x, y, z), from_matrix(pose_sd))
        on_arrival = stamped.time_ns == stamped.received_ns
        if s.newest is None or s.bank is None:
            self._begin(sample, on_arrival)
            s.filter_state = after_a_jump(s.filter_state)
        elif sample.time_ns < s.newest.time_ns:
            s.reordered += 1
            return
        elif self._is_duplicate(s.newest, sample):
            s.duplicates += 1
            return
        elif self._is_jump(s.newest, sample):
            self._begin(sample, on_arrival)
            s.filter_state = after_a_jump(s.filter_state)
        elif sample.received_ns - s.newest.received_ns > LOST_PERIODS * self._gap_period_s * NS:
            self._begin(sample, on_arrival)
        else:
            self._follow(s.bank, sample)
        s.newest = sample
        self._update_curve(sample, on_arrival)

    def _is_duplicate(self, newest: StreamSample, sample: StreamSample) -> bool:
        if sample.time_ns == newest.time_ns:
            return True
        if (sample.time_ns - newest.time_ns) / NS >= REPEATED * self._state.sampling_clock.period_s:
            return False
        turn = to_rotation_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        return sample.position == newest.position and length(turn) < 1e-9

    def _is_jump(self, newest: StreamSample, sample: StreamSample) -> bool:
        """Faster than the reference may move: no motion that could be followed."""
        elapsed_s = max(
            (sample.time_ns - newest.time_ns) / NS, 0.5 * self._state.sampling_clock.period_s, SHORTEST_JUDGED_S
        )
        turn = to_rotation_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        way = difference(sample.position, newest.position)
        return length(way) > self._pace.linear.speed * elapsed_s or length(turn) > self._pace.angular.speed * elapsed_s

    def _begin(self, sample: StreamSample, on_arrival: bool) -> None:
        s = self._state
        s.sampling_clock = reset(s.sampling_clock, sample.time_ns)
        s.bank = new_bank(sample.position, sample.orientation, s.bank, on_arrival)

    def _follow(self, bank: PredictorBank, sample: StreamSample) -> None:
        s = self._state
        before = s.sampling_clock
        s.sampling_clock = updated(before, sample.time_ns)
        raw_s = (sample.time_ns - before.time_ns) / NS
        regular_s = raw_s + s.sampling_clock.offset_s - before.offset_s
        s.bank = updated_bank(bank, sample.position, sample.orientation, (raw_s, regular_s), s.sampling_clock.period_s)

    def _update_curve(self, sample: StreamSample, on_arrival: bool) -> None:
        """The curve about the newest sample, and how far behind it to run."""
        s = self._state
        bank, sampling_clock = s.bank, s.sampling_clock
        if bank is None:
            return
        time_ns = sample.time_ns
        if bank.regular:
            time_ns += round((sampling_clock.offset_s - (sampling_clock.delay_s if on_arrival else 0.0)) * NS)
        earliest_ns = sample.received_ns - round(LONGEST_TRANSPORT_S * NS)
        if time_ns < earliest_ns:
            s.late += 1
            time_ns = earliest_ns
        s.curve = TargetCurve(time_ns, *bank.curve(), sample.orientation)
        linear, angular = bank.unpredictability
        s.linear_latency = s.linear_latency.moving_to(
            target_latency(linear, self._max_latency[0] * sampling_clock.period_s), sample.received_ns
        )
        s.angular_latency = s.angular_latency.moving_to(
            target_latency(angular, self._max_latency[1] * sampling_clock.period_s), sample.received_ns
        )
        self._update_arrays()

    def _update_arrays(self) -> None:
        """What a tick reads, after everything that changes it."""
        s, prediction = self._state, NO_PREDICTION
        if s.newest is not None and s.curve is not None:
            prediction = TargetPrediction(
                s.newest, s.curve, s.linear_latency, s.angular_latency, s.sampling_clock.period_s
            )
        self._prediction_arrays = as_arrays(prediction, self._pace)

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        Time never runs backwards: an earlier ``time_ns`` gives the present state again.
        """
        s = self._state
        follows = s.curve is not None and not s.held
        at_ns, numbers, schedule, pose_sd, twist_d = advanced_filter(
            *s.filter_state, *self._prediction_arrays, follows, time_ns, hold_s
        )
        s.filter_state = PackedFilterState(at_ns, numbers, schedule)
        return Motion(pose_sd, twist_d)

    def motion(self) -> RigidMotion:
        """The reference now."""
        return self._state.filter_state.motion

    @property
    def _gap_period_s(self) -> float:
        return gap_period_s(self._state.sampling_clock.period_s)

    @property
    def period_s(self) -> float:
        """Estimated sample period [s]."""
        return self._state.sampling_clock.period_s

    def silent_s(self, now_ns: int) -> float:
        """Time since the last sample that was used arrived [s]; infinite before the first."""
        newest = self._state.newest
        return (now_ns - newest.received_ns) / NS if newest else inf

    @property
    def ended(self) -> bool:
        """The stream has been silent for longer than the time-out; the motion goes to, and stays at, its last pose."""
        return self._pace.timeout_s < self.silent_s(self._state.filter_state.time_ns) < inf

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return self._state.filter_state.jumped

    @property
    def goal_sd(self) -> Array | None:
        """The last sample (4, 4); None before the first."""
        newest = self._state.newest
        return pose_matrix(resting(newest.position, newest.orientation)) if newest else None

    @property
    def latency_s(self) -> tuple[float, float]:
        """How far behind the target position and orientation run on purpose [s]."""
        s = self._state
        return latency_at(s.linear_latency, s.filter_state.time_ns)[0], latency_at(
            s.angular_latency, s.filter_state.time_ns
        )[0]

    @property
    def samples(self) -> int:
        """Samples since the start, whatever became of them."""
        return self._state.samples

    @property
    def duplicates(self) -> int:
        """Samples that repeated the one before."""
        return self._state.duplicates

    @property
    def reordered(self) -> int:
        """Samples that came after a newer one; they are left out."""
        return self._state.reordered

    @property
    def late(self) -> int:
        """Samples that were longer on their way than is extrapolated over."""
        return self._state.late

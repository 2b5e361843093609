"""Streams of poses: irregular samples in, a smooth reference motion at every control step out.

``sampling_clock.py`` estimates when each sample was taken, ``predictors.py`` where the target is now, and
``tracking_filter.py`` leads a motion with bounded speed, acceleration and jerk to it. An unpredictable target is
followed with a constant delay, which turns extrapolation into smoothing; a predictable one without lag. The errors of
past predictions decide (``latency.py``).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import inf

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.delivery import StreamDelivery, delivered
from ik_node.interfaces.motion import Motion
from ik_node.math.quaternion import conjugate, difference, from_matrix, length, multiply, to_rotation_vector
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.bounds import stream_bounds
from ik_node.targets.jerk_limited_filter import RigidMotion, pose_matrix
from ik_node.targets.stream.acceleration_load import AccelerationLoad, accelerates_text, updated_load
from ik_node.targets.stream.extrapolation import TargetCurve, resting
from ik_node.targets.stream.latency import ANGULAR_DELAY, LINEAR_DELAY, Latency, latency_at
from ik_node.targets.stream.predictors import PredictorBank, new_bank, updated_bank
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated
from ik_node.targets.stream.target_speed import TargetSpeed, too_fast_text, updated_speed
from ik_node.targets.stream.tracking_filter import (
    BRIDGE_PERIODS,
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

LOST_PERIODS = 4.0
"""After a gap longer than this many periods, prediction starts anew."""
LONGEST_TRANSPORT_S = 0.1
"""Longest transport time that extrapolation compensates."""
SHORTEST_JUDGED_S = 0.01
"""Smallest interval for the detection of jumps: the speeds of fast streams are noisy."""
REPEATED = 0.5
"""The same pose again within this fraction of a period is a duplicate, not a sample of a target at rest."""


@dataclass
class StreamSnapshot:
    """State of :class:`StreamedPoses`; all values are immutable, so a shallow copy is a snapshot."""

    filter_state: PackedFilterState = field(default_factory=lambda: filter_state_from(RigidMotion(), 0))
    newest: StreamSample | None = None
    sampling_clock: SamplingClock = field(default_factory=SamplingClock)
    bank: PredictorBank | None = None
    curve: TargetCurve | None = None
    linear_latency: Latency = field(default_factory=Latency)
    angular_latency: Latency = field(default_factory=Latency)
    held: bool = False
    delivery: StreamDelivery = field(default_factory=StreamDelivery)
    gap_ns: int = 0
    duplicates: int = 0
    reordered: int = 0
    speed: TargetSpeed = field(default_factory=TargetSpeed)
    load: AccelerationLoad = field(default_factory=AccelerationLoad)


class StreamedPoses:
    """Samples of a pose in, T_sd(t) and V_d(t) out; times are monotonic nanoseconds."""

    def __init__(self, settings: TargetSettings) -> None:
        self._state = StreamSnapshot()
        self.configure(settings)

    def configure(self, settings: TargetSettings) -> None:
        """Applies other settings; the estimates of the stream are kept."""
        self._bounds = TrackingBounds(*stream_bounds(settings), settings.timeout_s)
        self._max_speed, self._max_acceleration = settings.max_speed, settings.max_acceleration
        self._pack_inputs()

    def capture(self) -> StreamSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: StreamSnapshot) -> None:
        """Continues from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._pack_inputs()

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Starts at rest at ``pose_sd`` (4, 4) without samples."""
        x, y, z = pose_sd[:3, 3].tolist()
        self.take_over(resting((x, y, z), from_matrix(pose_sd)), time_ns)

    def take_over(self, motion: RigidMotion, time_ns: int) -> None:
        """Starts as :meth:`start` does, with the pose and the velocity of another reference."""
        self._state = StreamSnapshot(filter_state_from(motion, time_ns), delivery=self._state.delivery)
        self._pack_inputs()

    def rest_at(self, motion: RigidMotion, time_ns: int) -> None:
        """Keeps following the same samples, from another motion."""
        self._state.filter_state = moved_to(self._state.filter_state, motion, time_ns)

    def replace(self, pose_sd: Array | None, motion: RigidMotion, time_ns: int) -> None:
        """Replaces the newest sample by another pose (4, 4), which is followed from another motion."""
        s = self._state
        s.filter_state = moved_to(s.filter_state, motion, time_ns)
        if s.newest is None or pose_sd is None:
            return
        x, y, z = pose_sd[:3, 3].tolist()
        s.newest = s.newest._replace(position=(x, y, z), orientation=from_matrix(pose_sd))
        on_arrival = s.newest.time_ns == s.newest.received_ns
        self._begin(s.newest, on_arrival)
        s.filter_state = after_a_jump(s.filter_state)
        self._update_curve(s.newest, on_arrival)

    def hold(self) -> None:
        """Stops following: comes to rest within the bounds until :meth:`start`."""
        self._state.held = True

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Adds a sample.

        Args:
            pose_sd: T_sd (4, 4), checked.
            stamped: Its times.
        """
        s = self._state
        s.delivery = delivered(s.delivery, stamped, self._bounds.timeout_s)
        silent_s = self.silent_s(stamped.received_ns)
        if s.newest and BRIDGE_PERIODS * self._gap_period_s < silent_s < self._bounds.timeout_s:
            s.gap_ns = s.newest.received_ns
        elif silent_s > REPEATED * self.period_s:  # samples that have queued up come together
            s.gap_ns = 0
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
        s.speed = updated_speed(s.speed, sample.time_ns, sample.position, sample.orientation, self._max_speed)
        motion, counts = s.filter_state.motion, not s.filter_state.jumped
        accelerations = (counts * length(motion.acceleration), counts * length(motion.angular_acceleration))
        s.load = updated_load(s.load, sample.received_ns, accelerations, self._max_acceleration)
        self._update_curve(sample, on_arrival)

    def _is_duplicate(self, newest: StreamSample, sample: StreamSample) -> bool:
        if sample.time_ns == newest.time_ns:
            return True
        if (sample.time_ns - newest.time_ns) / NS >= REPEATED * self._state.sampling_clock.period_s:
            return False
        turn = to_rotation_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        return sample.position == newest.position and length(turn) < 1e-9

    def _is_jump(self, newest: StreamSample, sample: StreamSample) -> bool:
        """True if the reference may not move as fast as the samples do."""
        elapsed_s = max(
            (sample.time_ns - newest.time_ns) / NS, 0.5 * self._state.sampling_clock.period_s, SHORTEST_JUDGED_S
        )
        turn = to_rotation_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        way = difference(sample.position, newest.position)
        return (
            length(way) > self._bounds.linear.speed * elapsed_s or length(turn) > self._bounds.angular.speed * elapsed_s
        )

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
        """Updates the predicted curve and the latencies after a sample."""
        s = self._state
        bank, sampling_clock = s.bank, s.sampling_clock
        if bank is None:
            return
        time_ns = sample.time_ns
        if bank.regular:
            time_ns += round((sampling_clock.offset_s - (sampling_clock.delay_s if on_arrival else 0.0)) * NS)
        time_ns = max(time_ns, sample.received_ns - round(LONGEST_TRANSPORT_S * NS))
        s.curve = TargetCurve(time_ns, *bank.curve(), sample.orientation)
        (linear, angular), period_s, now_ns = bank.unpredictability, sampling_clock.period_s, sample.received_ns
        s.linear_latency = s.linear_latency.updated(linear, LINEAR_DELAY.at(period_s), now_ns)
        s.angular_latency = s.angular_latency.updated(angular, ANGULAR_DELAY.at(period_s), now_ns)
        self._pack_inputs()

    def _pack_inputs(self) -> None:
        """Packs the inputs of the tracking filter; called after every change of them."""
        s, prediction = self._state, NO_PREDICTION
        if s.newest is not None and s.curve is not None:
            prediction = TargetPrediction(
                s.newest, s.curve, s.linear_latency, s.angular_latency, s.sampling_clock.period_s
            )
        self._filter_inputs = as_arrays(prediction, self._bounds)

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The desired motion at a control step.

        Time never runs backwards: an earlier ``time_ns`` gives the present state again.

        Args:
            time_ns: Monotonic time of the step.
            hold_s: Time for which the twist will be applied.

        Returns:
            T_sd at ``time_ns`` and its mean body twist V_d over ``hold_s``.
        """
        s = self._state
        follows = s.curve is not None and not s.held
        at_ns, numbers, schedule, pose_sd, twist_d = advanced_filter(
            *s.filter_state, self._filter_inputs, follows, time_ns, hold_s
        )
        s.filter_state = PackedFilterState(at_ns, numbers, schedule)
        return Motion(pose_sd, twist_d)

    def motion(self) -> RigidMotion:
        """The reference at the last control step."""
        return self._state.filter_state.motion

    @property
    def _gap_period_s(self) -> float:
        return gap_period_s(self._state.sampling_clock.period_s)

    @property
    def period_s(self) -> float:
        """Estimated sample period [s]."""
        return self._state.sampling_clock.period_s

    def silent_s(self, now_ns: int) -> float:
        """Time since the last accepted sample arrived [s]; infinite before the first."""
        newest = self._state.newest
        return (now_ns - newest.received_ns) / NS if newest else inf

    @property
    def ended(self) -> bool:
        """True if no sample arrived for longer than the time-out; the motion then ends at the last pose."""
        return self._bounds.timeout_s < self.silent_s(self._state.filter_state.time_ns) < inf

    @property
    def jumped(self) -> bool:
        """True from a jump of the target until the motion has arrived."""
        return self._state.filter_state.jumped

    @property
    def too_fast(self) -> str:
        """Warning that the target moves or accelerates faster than the reference may; empty if it does not."""
        s, time_ns = self._state, self._state.filter_state.time_ns
        return too_fast_text(s.speed, time_ns, self._max_speed) or accelerates_text(
            s.load, time_ns, self._max_acceleration
        )

    @property
    def goal_sd(self) -> Array | None:
        """The last sample (4, 4); None before the first."""
        newest = self._state.newest
        return pose_matrix(resting(newest.position, newest.orientation)) if newest else None

    @property
    def latency_s(self) -> tuple[float, float]:
        """Present smoothing delay of position and orientation [s]."""
        s = self._state
        time_ns = s.filter_state.time_ns
        return latency_at(s.linear_latency, time_ns)[0], latency_at(s.angular_latency, time_ns)[0]

    @property
    def gap_ns(self) -> int:
        """Monotonic begin of the gap before the newest sample in which the reference decelerated; 0 for none."""
        return self._state.gap_ns

    def counts(self) -> dict[str, int]:
        """Numbers of targets received, late and lost from the first one on, and the age of the newest, in ms."""
        delivery, time_ns = self._state.delivery, self._state.filter_state.time_ns
        age_ms = (time_ns - delivery.time_ns) * 1000 // NS if delivery.received else 0
        return {
            "targets": delivery.received,
            "targets_late": delivery.late,
            "targets_lost": delivery.lost,
            "target_age_ms": max(age_ms, 0),
        }

    @property
    def duplicates(self) -> int:
        """Number of samples that repeated the previous one."""
        return self._state.duplicates

    @property
    def reordered(self) -> int:
        """Number of samples that arrived after a newer one and were ignored."""
        return self._state.reordered

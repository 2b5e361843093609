"""Streamed poses as a smooth motion.

Samples come when they come; the motion is asked for at every control tick. ``cadence.py`` says when each sample was
taken, ``predictors.py`` where the target is now, and ``pursuit.py`` leads a motion with bounded speed, acceleration and
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
from ik_node.math.quaternion import conjugate, difference, from_matrix, length, multiply, to_vector
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.jerk_limited_filter import Bounds, RigidMotion, pose_of
from ik_node.targets.stream.extrapolation import Curve, resting
from ik_node.targets.stream.latency import Latency, lag_at, wanted
from ik_node.targets.stream.predictors import Bank, begun, updated
from ik_node.targets.stream.sampling_clock import Cadence, followed, restarted
from ik_node.targets.stream.tracking_filter import (
    NOWHERE,
    Course,
    Pace,
    Pursuit,
    Sample,
    after_a_jump,
    elsewhere,
    gap_period_s,
    packed,
    pursued,
    pursuit_from,
)

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

    pursuit: Pursuit = field(default_factory=lambda: pursuit_from(RigidMotion(), 0))
    newest: Sample | None = None
    cadence: Cadence = field(default_factory=Cadence)
    bank: Bank | None = None
    curve: Curve | None = None
    linear_latency: Latency = field(default_factory=Latency)
    angular_latency: Latency = field(default_factory=Latency)
    held: bool = False
    samples: int = 0
    duplicates: int = 0
    late: int = 0
    reordered: int = 0


class StreamedPoses:
    """Samples of a pose in, T_sd(t) and V_d(t) out. All times are monotonic nanoseconds."""

    def __init__(self, settings: TargetSettings) -> None:
        self._state = StreamSnapshot()
        self.configure(settings)

    def configure(self, settings: TargetSettings) -> None:
        """Other settings from now on; what has been learnt of the stream stays."""
        self._settings = settings
        self._pace = Pace(
            Bounds(
                settings.max_linear_speed,
                settings.max_linear_acceleration,
                settings.max_linear_jerk,
                settings.catch_up_linear_speed,
            ),
            Bounds(
                settings.max_angular_speed,
                settings.max_angular_acceleration,
                settings.max_angular_jerk,
                settings.catch_up_angular_speed,
            ),
            settings.bandwidth,
            settings.max_bandwidth,
            settings.timeout_s,
        )
        self._pack()

    def capture(self) -> StreamSnapshot:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, snapshot: StreamSnapshot) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(snapshot)
        self._pack()

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd`` (4, 4); every sample and figure is forgotten."""
        x, y, z = pose_sd[:3, 3].tolist()
        self.take_over(resting((x, y, z), from_matrix(pose_sd)), time_ns)

    def take_over(self, motion: RigidMotion, time_ns: int) -> None:
        """As :meth:`start`, from where another reference is, and as it moves."""
        self._state = StreamSnapshot(pursuit_from(motion, time_ns))
        self._pack()

    def rest_at(self, motion: RigidMotion, time_ns: int) -> None:
        """Goes on following the same samples from somewhere else."""
        self._state.pursuit = elsewhere(self._state.pursuit, motion, time_ns)

    def hold(self) -> None:
        """Stops following: comes to rest within the bounds and stays there until :meth:`start`."""
        self._state.held = True

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """One checked pose (4, 4) of the stream."""
        s = self._state
        s.samples += 1
        x, y, z = pose_sd[:3, 3].tolist()
        sample = Sample(stamped.time_ns, stamped.received_ns, (x, y, z), from_matrix(pose_sd))
        on_arrival = stamped.time_ns == stamped.received_ns
        if s.newest is None or s.bank is None:
            self._begin(sample, on_arrival)
            s.pursuit = after_a_jump(s.pursuit)
        elif sample.time_ns < s.newest.time_ns:
            s.reordered += 1
            return
        elif self._repeats(s.newest, sample):
            s.duplicates += 1
            return
        elif self._jumps(s.newest, sample):
            self._begin(sample, on_arrival)
            s.pursuit = after_a_jump(s.pursuit)
        elif sample.received_ns - s.newest.received_ns > LOST_PERIODS * self._gap_period_s * NS:
            self._begin(sample, on_arrival)
        else:
            self._follow(s.bank, sample)
        s.newest = sample
        self._draw(sample, on_arrival)

    def _repeats(self, newest: Sample, sample: Sample) -> bool:
        if sample.time_ns == newest.time_ns:
            return True
        if (sample.time_ns - newest.time_ns) / NS >= REPEATED * self._state.cadence.period_s:
            return False
        turn = to_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        return sample.position == newest.position and length(turn) < 1e-9

    def _jumps(self, newest: Sample, sample: Sample) -> bool:
        """Faster than the reference may move: no motion that could be followed."""
        elapsed_s = max((sample.time_ns - newest.time_ns) / NS, 0.5 * self._state.cadence.period_s, SHORTEST_JUDGED_S)
        turn = to_vector(multiply(sample.orientation, conjugate(newest.orientation)))
        way = difference(sample.position, newest.position)
        return length(way) > self._pace.linear.speed * elapsed_s or length(turn) > self._pace.angular.speed * elapsed_s

    def _begin(self, sample: Sample, on_arrival: bool) -> None:
        s = self._state
        s.cadence = restarted(s.cadence, sample.time_ns)
        s.bank = begun(sample.position, sample.orientation, s.bank, on_arrival)

    def _follow(self, bank: Bank, sample: Sample) -> None:
        s = self._state
        before = s.cadence
        s.cadence = followed(before, sample.time_ns)
        raw_s = (sample.time_ns - before.time_ns) / NS
        regular_s = raw_s + s.cadence.offset_s - before.offset_s
        s.bank = updated(bank, sample.position, sample.orientation, (raw_s, regular_s), s.cadence.period_s)

    def _draw(self, sample: Sample, on_arrival: bool) -> None:
        """The curve about the newest sample, and how far behind it to run."""
        s = self._state
        bank, cadence = s.bank, s.cadence
        if bank is None:
            return
        time_ns = sample.time_ns
        if bank.regular:
            time_ns += round((cadence.offset_s - (cadence.delay_s if on_arrival else 0.0)) * NS)
        earliest_ns = sample.received_ns - round(LONGEST_TRANSPORT_S * NS)
        if time_ns < earliest_ns:
            s.late += 1
            time_ns = earliest_ns
        s.curve = Curve(time_ns, *bank.curve(), sample.orientation)
        linear, angular = bank.unpredictability
        s.linear_latency = s.linear_latency.drawn_to(
            wanted(linear, self._settings.latency_linear * cadence.period_s), sample.received_ns
        )
        s.angular_latency = s.angular_latency.drawn_to(
            wanted(angular, self._settings.latency_angular * cadence.period_s), sample.received_ns
        )
        self._pack()

    def _pack(self) -> None:
        """What a tick reads, after everything that changes it."""
        s, course = self._state, NOWHERE
        if s.newest is not None and s.curve is not None:
            course = Course(s.newest, s.curve, s.linear_latency, s.angular_latency, s.cadence.period_s)
        self._packed = packed(course, self._pace)

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        Time never runs backwards: an earlier ``time_ns`` gives the present state again.
        """
        s = self._state
        follows = s.curve is not None and not s.held
        at_ns, numbers, plan, pose_sd, twist_d = pursued(*s.pursuit, *self._packed, follows, time_ns, hold_s)
        s.pursuit = Pursuit(at_ns, numbers, plan)
        return Motion(pose_sd, twist_d)

    def motion(self) -> RigidMotion:
        """The reference now."""
        return self._state.pursuit.motion

    @property
    def _gap_period_s(self) -> float:
        return gap_period_s(self._state.cadence.period_s)

    @property
    def period_s(self) -> float:
        """Estimated sample period [s]."""
        return self._state.cadence.period_s

    def silent_s(self, now_ns: int) -> float:
        """Time since the last sample that was used arrived [s]; infinite before the first."""
        newest = self._state.newest
        return (now_ns - newest.received_ns) / NS if newest else inf

    @property
    def ended(self) -> bool:
        """The stream has been silent for longer than the time-out; the motion goes to, and stays at, its last pose."""
        return self._pace.timeout_s < self.silent_s(self._state.pursuit.time_ns) < inf

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return self._state.pursuit.jumped

    @property
    def goal_sd(self) -> Array | None:
        """The last sample (4, 4); None before the first."""
        newest = self._state.newest
        return pose_of(resting(newest.position, newest.orientation)) if newest else None

    @property
    def latency_s(self) -> tuple[float, float]:
        """How far behind the target position and orientation run on purpose [s]."""
        s = self._state
        return lag_at(s.linear_latency, s.pursuit.time_ns)[0], lag_at(s.angular_latency, s.pursuit.time_ns)[0]

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

"""Streamed poses as a smooth motion.

Samples come when they come; the motion is asked for at every control tick. ``cadence.py`` says when each sample was
taken, ``predictors.py`` where the target is now, and ``reference.py`` chases it with bounded speed, acceleration and
jerk. A target that is hard to foretell is followed a part of a sample period late: interpolation is better than
extrapolation then. How late follows from how wrong the predictions have been, so that a smooth target is followed
without lag.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import ceil, inf
from typing import NamedTuple

from ik_node.clock import NS, Stamped
from ik_node.se3 import Array
from ik_node.settings import TargetSettings
from ik_node.trajectory.cadence import Cadence, followed, restarted
from ik_node.trajectory.curve import Curve, Moment, evaluate, resting
from ik_node.trajectory.latency import Latency, wanted
from ik_node.trajectory.motion import Motion
from ik_node.trajectory.predictors import Bank, begun, updated
from ik_node.trajectory.reference import (
    Bounds,
    Jerk,
    RigidMotion,
    chase,
    mean_twist,
    move,
    orientation_error,
    pose_of,
)
from ik_node.trajectory.rotations import (
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    difference,
    from_matrix,
    length,
    multiply,
    to_vector,
)

LONGEST_STEP_S = 0.004
"""A jerk is held no longer than this; longer intervals are cut."""
LONGEST_CATCH_UP_S = 0.25
"""The motion makes up for missed ticks over at most this time; beyond, it goes on from where it is."""
SHORTEST_GAP_PERIOD_S = 0.02
"""Gaps are judged as if the period were at least this: fast streams are held up by networks for several periods."""
BRIDGE_PERIODS = 2.25
"""Silence for so many periods changes nothing: one lost sample. Over the next period the motion comes to rest."""
LOST_PERIODS = 4.0
"""A gap longer than this many periods ends what the older samples say about the motion."""
BLEND_PERIODS = 8.0
"""Over so many periods the motion comes back from where it was extrapolated to, to the last sample."""
LONGEST_TRANSPORT_S = 0.1
"""A target is extrapolated over the time that its samples take to arrive for at most this."""
SHORTEST_JUDGED_S = 0.01
"""Whether samples are a jump is judged as if they were at least this far apart: fast streams have noisy rates."""
REPEATED = 0.5
"""The same pose again within this part of a period is a duplicate, not a sample of a target at rest."""
ARRIVED_M, ARRIVED_RAD = 5e-3, 2e-2
"""A jump is over when the motion is this near to the target."""


class Sample(NamedTuple):
    """A pose of the stream that is used."""

    time_ns: int
    """Its stamp, on the monotonic clock."""
    received_ns: int
    position: Vector
    orientation: Quaternion


@dataclass
class StreamState:
    """Everything that the motion remembers. Values are immutable, so that a shallow copy is a snapshot."""

    time_ns: int = 0
    motion: RigidMotion = field(default_factory=RigidMotion)
    plan: tuple[Jerk, ...] = ()
    """Jerks from ``time_ns`` on, as promised by the last twist."""
    hold_s: float = 0.0
    """For how long the last twist was to hold."""
    turn: Vector = ZERO
    """Last orientation error [rad]."""
    newest: Sample | None = None
    cadence: Cadence = field(default_factory=Cadence)
    bank: Bank | None = None
    curve: Curve | None = None
    linear_latency: Latency = field(default_factory=Latency)
    angular_latency: Latency = field(default_factory=Latency)
    jumped: bool = False
    held: bool = False
    samples: int = 0
    duplicates: int = 0
    late: int = 0
    reordered: int = 0


class StreamedPoses:
    """Samples of a pose in, T_sd(t) and V_d(t) out. All times are monotonic nanoseconds."""

    def __init__(self, settings: TargetSettings) -> None:
        self.configure(settings)
        self._state = StreamState()

    def configure(self, settings: TargetSettings) -> None:
        """Other settings from now on; what has been learnt of the stream stays."""
        self._settings = settings
        self._timeout_s = settings.timeout_s
        self._linear = Bounds(
            settings.max_linear_speed,
            settings.max_linear_acceleration,
            settings.max_linear_jerk,
            settings.catch_up_linear_speed,
        )
        self._angular = Bounds(
            settings.max_angular_speed,
            settings.max_angular_acceleration,
            settings.max_angular_jerk,
            settings.catch_up_angular_speed,
        )

    def state(self) -> StreamState:
        """A snapshot, for :meth:`restore`."""
        return dataclasses.replace(self._state)

    def restore(self, state: StreamState) -> None:
        """Goes on from a snapshot, bit for bit."""
        self._state = dataclasses.replace(state)

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd`` (4, 4); every sample and figure is forgotten."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._state = StreamState(time_ns=time_ns, motion=resting((x, y, z), from_matrix(pose_sd)))

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
            s.jumped = True
        elif sample.time_ns < s.newest.time_ns:
            s.reordered += 1
            return
        elif self._repeats(s.newest, sample):
            s.duplicates += 1
            return
        elif self._jumps(s.newest, sample):
            self._begin(sample, on_arrival)
            s.jumped = True
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
        return length(way) > self._linear.speed * elapsed_s or length(turn) > self._angular.speed * elapsed_s

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

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        Time never runs backwards: an earlier ``time_ns`` gives the present state again.
        """
        s = self._state
        self._catch_up(time_ns)
        s.hold_s = hold_s
        steps = max(1, ceil(hold_s / LONGEST_STEP_S - 1e-9))
        step_s = hold_s / steps
        motion = s.motion
        plan = []
        for step in range(steps):
            jerk = self._jerk(motion, s.time_ns + round(step * step_s * NS), step_s)
            plan.append(jerk)
            motion = move(motion, jerk, step_s)
        s.plan = tuple(plan)
        return Motion(pose_of(s.motion), mean_twist(s.motion, motion, hold_s))

    def _catch_up(self, time_ns: int) -> None:
        """To ``time_ns``: as planned first, and where the tick is late, on from there."""
        s = self._state
        if time_ns <= s.time_ns:
            return
        left_s = min((time_ns - s.time_ns) / NS, LONGEST_CATCH_UP_S)
        for jerk in s.plan:
            part_s = min(jerk.duration_s, left_s)
            s.motion = move(s.motion, jerk, part_s)
            left_s -= part_s
            if left_s <= 0.0:
                break
        while left_s > 1e-9:
            part_s = min(LONGEST_STEP_S, left_s)
            s.motion = move(s.motion, self._jerk(s.motion, time_ns - round(left_s * NS), part_s), part_s)
            left_s -= part_s
        s.time_ns = time_ns

    def _jerk(self, motion: RigidMotion, time_ns: int, step_s: float) -> Jerk:
        s = self._state
        omega = min(self._settings.bandwidth / s.cadence.period_s, self._settings.max_bandwidth)
        goal, way = resting(motion.position, motion.orientation), ZERO
        if s.curve is None or s.newest is None or s.held:
            s.turn = ZERO
        else:
            goal = self._goal(s.curve, s.newest, time_ns)
            way = difference(goal.position, motion.position)
            s.turn = orientation_error(goal.orientation, motion.orientation, s.turn)
            if s.jumped and length(way) < ARRIVED_M and length(s.turn) < ARRIVED_RAD:
                s.jumped = False
        linear = chase(
            way, motion.velocity, motion.acceleration, goal.velocity, goal.acceleration, omega, self._linear, step_s
        )
        angular = chase(
            s.turn,
            motion.rate,
            motion.angular_acceleration,
            goal.rate,
            goal.angular_acceleration,
            omega,
            self._angular,
            step_s,
        )
        return Jerk(linear, angular, step_s)

    def _goal(self, curve: Curve, newest: Sample, time_ns: int) -> RigidMotion:
        """Where the target is now: along the curve while samples come, at rest a little further when they stop."""
        s = self._state
        period_s = self._gap_period_s
        age_s = (time_ns - curve.time_ns) / NS
        silent_s = (time_ns - newest.received_ns) / NS
        pace, change, back = 1.0, 0.0, 1.0
        over_s = silent_s - BRIDGE_PERIODS * period_s - s.hold_s  # what arrives meanwhile is seen at the next tick
        if over_s > 0.0:
            if over_s < period_s:
                age_s -= 0.5 * over_s * over_s / period_s
                pace, change = 1.0 - over_s / period_s, -1.0 / period_s
            else:
                age_s -= over_s - 0.5 * period_s
                pace = 0.0
            left = 1.0 - (silent_s - self._timeout_s) / (BLEND_PERIODS * period_s)
            if left <= 0.0:
                return resting(newest.position, newest.orientation)
            if left < 1.0:
                back = left * left * (3.0 - 2.0 * left)
        linear_s, linear_rate = s.linear_latency.at(time_ns)
        angular_s, angular_rate = s.angular_latency.at(time_ns)
        return evaluate(
            curve,
            Moment(back * (age_s - linear_s), pace * (1.0 - linear_rate), change),
            Moment(back * (age_s - angular_s), pace * (1.0 - angular_rate), change),
        )

    @property
    def _gap_period_s(self) -> float:
        return max(self._state.cadence.period_s, SHORTEST_GAP_PERIOD_S)

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
        return self._timeout_s < self.silent_s(self._state.time_ns) < inf

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return self._state.jumped

    @property
    def goal_sd(self) -> Array | None:
        """The last sample (4, 4); None before the first."""
        newest = self._state.newest
        return pose_of(resting(newest.position, newest.orientation)) if newest else None

    @property
    def latency_s(self) -> tuple[float, float]:
        """How far behind the target position and orientation run on purpose [s]."""
        s = self._state
        return s.linear_latency.at(s.time_ns)[0], s.angular_latency.at(s.time_ns)[0]

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

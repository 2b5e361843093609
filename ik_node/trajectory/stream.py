"""Streamed poses as a smooth motion.

Samples come when they come; the motion is asked for at every control tick. A curve through the newest samples says
where the target is now, and a reference with bounded speed, acceleration and jerk (``reference.py``) chases it.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from math import ceil, sqrt
from statistics import median_low

import numpy as np

from ik_node.clock import NS, Stamped
from ik_node.se3 import Array
from ik_node.settings import TargetSettings
from ik_node.trajectory.motion import Motion
from ik_node.trajectory.reference import Bounds, Jerk, RigidMotion, chase, move, orientation_error
from ik_node.trajectory.rotations import (
    ZERO,
    Vector,
    conjugate,
    from_matrix,
    multiply,
    rotate_back,
    to_matrix,
    to_vector,
)
from ik_node.trajectory.samples import Curve, Sample, evaluate, fit, resting

LONGEST_STEP_S = 0.004
"""A jerk is held no longer than this; longer intervals are cut."""
LONGEST_CATCH_UP_S = 0.25
"""The motion makes up for missed ticks over at most this time; beyond, it goes on from where it is."""
UNKNOWN_PERIOD_S = 0.05
"""Sample period that is assumed until two samples have come."""
HISTORY = 12
"""Samples kept."""
INTERVALS = 11
"""Intervals from which the sample period is taken."""
FIT_WINDOW_S = 0.06
"""Time that the curve through the newest samples should cover."""
SHORTEST_GAP_PERIOD_S = 0.02
"""Gaps are judged as if the period were at least this: fast streams are held up by networks for several periods."""
BRIDGE_PERIODS = 2.25
"""Silence for so many periods changes nothing: one lost sample. Over the next period the motion comes to rest."""
LOST_PERIODS = 4.0
"""A gap longer than this many periods ends what the older samples say about the motion."""
BLEND_PERIODS = 8.0
"""Over so many periods the motion comes back from where it was extrapolated to, to the last sample."""


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
    recent: tuple[Sample, ...] = ()
    intervals: tuple[int, ...] = ()
    """Between samples [ns], newest last."""
    period_s: float = UNKNOWN_PERIOD_S
    curve: Curve | None = None
    last_received_ns: int = 0
    samples_received: int = 0
    jumped: bool = False
    held: bool = False
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
        self._timeout_ns = round(settings.timeout_s * NS)
        self._linear = Bounds(
            settings.max_linear_speed,
            settings.max_linear_acceleration,
            settings.max_linear_jerk,
            settings.max_linear_speed,
        )
        self._angular = Bounds(
            settings.max_angular_speed,
            settings.max_angular_acceleration,
            settings.max_angular_jerk,
            settings.max_angular_speed,
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
        self._state = StreamState(
            time_ns=time_ns, motion=RigidMotion(position=(x, y, z), orientation=from_matrix(pose_sd))
        )

    def hold(self) -> None:
        """Stops following: comes to rest within the bounds and stays there until :meth:`start`."""
        self._state.held = True

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """One checked pose (4, 4) of the stream."""
        s = self._state
        x, y, z = pose_sd[:3, 3].tolist()
        sample = Sample(stamped.time_ns, stamped.received_ns, (x, y, z), from_matrix(pose_sd))
        s.samples_received += 1
        previous = s.recent[-1] if s.recent else None
        silent_s = (sample.received_ns - s.last_received_ns) / NS
        s.last_received_ns = max(s.last_received_ns, sample.received_ns)
        if previous is not None:
            interval = sample.time_ns - previous.time_ns
            if interval == 0:
                s.duplicates += 1
                return
            if interval < 0:
                s.reordered += 1
                return
            if silent_s < LOST_PERIODS * self._gap_period_s:
                s.intervals = (*s.intervals[-INTERVALS + 1 :], interval)
                s.period_s = _period(s.intervals)
            if self._jumps(previous, sample):
                s.jumped = True
                s.recent = ()
            elif silent_s >= LOST_PERIODS * self._gap_period_s:
                s.recent = ()
        else:
            s.jumped = True
        s.recent = (*s.recent[-HISTORY + 1 :], sample)
        s.curve = self._fit()

    def _jumps(self, previous: Sample, sample: Sample) -> bool:
        elapsed = max((sample.time_ns - previous.time_ns) / NS, 0.5 * self._state.period_s)
        turn = to_vector(multiply(sample.orientation, conjugate(previous.orientation)))
        return (
            _distance(sample.position, previous.position) > self._settings.max_linear_speed * elapsed
            or _distance(turn, ZERO) > self._settings.max_angular_speed * elapsed
        )

    def _fit(self) -> Curve:
        samples = self._state.recent
        newest = samples[-1]
        if len(samples) == 1:
            return resting(newest.position, newest.orientation)
        count = max(4, min(HISTORY, ceil(FIT_WINDOW_S / self._state.period_s) + 1))
        used = samples[-count:]
        return fit(used, 2 if len(used) > 2 else 1)

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The motion at ``time_ns`` and its mean twist over the ``hold_s`` that follow.

        Time never runs backwards: an earlier ``time_ns`` gives the present state again.
        """
        s = self._state
        self._catch_up(time_ns)
        s.hold_s = hold_s
        steps = max(1, ceil(hold_s / LONGEST_STEP_S - 1e-9))
        step_s = hold_s / steps
        motion, now_s, plan = s.motion, 0.0, []
        for _ in range(steps):
            jerk, s.turn = self._jerk(motion, s.time_ns + round(now_s * NS), step_s)
            plan.append(jerk)
            motion = move(motion, jerk, step_s)
            now_s += step_s
        s.plan = tuple(plan)
        return Motion(_pose(s.motion), _mean_twist(s.motion, motion, hold_s))

    def _catch_up(self, time_ns: int) -> None:
        s = self._state
        left_ns = time_ns - s.time_ns
        if left_ns <= 0:
            return
        left_s = min(left_ns / NS, LONGEST_CATCH_UP_S)
        for jerk in s.plan:
            part = min(jerk.duration_s, left_s)
            s.motion = move(s.motion, jerk, part)
            left_s -= part
            if left_s <= 0.0:
                break
        while left_s > 1e-9:
            part = min(LONGEST_STEP_S, left_s)
            jerk, s.turn = self._jerk(s.motion, time_ns - round(left_s * NS), part)
            s.motion = move(s.motion, jerk, part)
            left_s -= part
        s.time_ns = time_ns

    def _jerk(self, motion: RigidMotion, time_ns: int, step_s: float) -> tuple[Jerk, Vector]:
        s = self._state
        omega = min(2.0 / s.period_s, 40.0)
        if s.held or s.curve is None:
            goal, error, turn = RigidMotion(), ZERO, ZERO
        else:
            goal = self._goal(s.curve, time_ns)
            gx, gy, gz = goal.position
            x, y, z = motion.position
            error = (gx - x, gy - y, gz - z)
            turn = orientation_error(goal.orientation, motion.orientation, s.turn)
        linear = chase(
            error, motion.velocity, motion.acceleration, goal.velocity, goal.acceleration, omega, self._linear, step_s
        )
        angular = chase(
            turn,
            motion.rate,
            motion.angular_acceleration,
            goal.rate,
            goal.angular_acceleration,
            omega,
            self._angular,
            step_s,
        )
        if s.jumped and _distance(error, ZERO) < 5e-3 and _distance(turn, ZERO) < 2e-2:
            s.jumped = False
        return Jerk(linear, angular, step_s), turn

    def _goal(self, curve: Curve, time_ns: int) -> RigidMotion:
        """Where the target is now: along the curve while samples come, at rest a little further when they stop."""
        s = self._state
        newest = s.recent[-1]
        period = self._gap_period_s
        silent = (time_ns - s.last_received_ns) / NS
        age = (time_ns - newest.time_ns) / NS
        over = silent - BRIDGE_PERIODS * period - s.hold_s  # what arrives meanwhile is seen at the next tick
        if over <= 0.0:
            return evaluate(curve, age, 1.0, 0.0)
        if over < period:
            return evaluate(curve, age - over * over / (2.0 * period), 1.0 - over / period, -1.0 / period)
        end = age - over + 0.5 * period
        ended = silent - self._timeout_ns / NS
        if ended <= 0.0:
            return evaluate(curve, end, 0.0, 0.0)
        left = max(0.0, 1.0 - ended / (BLEND_PERIODS * period))
        if left == 0.0:
            return RigidMotion(position=newest.position, orientation=newest.orientation)
        smooth = left * left * (3.0 - 2.0 * left)
        return evaluate(curve, end * smooth, 0.0, 0.0)

    @property
    def _gap_period_s(self) -> float:
        return max(self._state.period_s, SHORTEST_GAP_PERIOD_S)

    @property
    def period_s(self) -> float:
        """Estimated sample period [s]."""
        return self._state.period_s

    def silent_s(self, now_ns: int) -> float:
        """Time since the last arrival [s]; infinite before the first."""
        s = self._state
        return (now_ns - s.last_received_ns) / NS if s.samples_received else float("inf")

    @property
    def ended(self) -> bool:
        """The stream has been silent for longer than the time-out; the motion goes to, and stays at, its last pose."""
        s = self._state
        return bool(s.recent) and s.time_ns - s.last_received_ns > self._timeout_ns

    @property
    def jumped(self) -> bool:
        """The target has jumped, and the motion is on its way to it."""
        return self._state.jumped

    @property
    def goal_sd(self) -> Array | None:
        """The last sample (4, 4); None before the first."""
        s = self._state
        return _pose(RigidMotion(s.recent[-1].position, orientation=s.recent[-1].orientation)) if s.recent else None

    @property
    def samples(self) -> int:
        """Samples since the start, whatever became of them."""
        return self._state.samples_received

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
        """Samples that were held up for longer than a gap is bridged."""
        return self._state.late


def _period(intervals: tuple[int, ...]) -> float:
    middle = median_low(intervals)
    kept = [i for i in intervals if 0.5 * middle <= i <= 1.5 * middle]
    return median_low(kept) / NS


def _distance(a: Vector, b: Vector) -> float:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return sqrt(x * x + y * y + z * z)


def _pose(motion: RigidMotion) -> Array:
    pose = np.empty((4, 4))
    pose[:3, :3] = to_matrix(motion.orientation)
    pose[:3, 3] = motion.position
    pose[3] = (0.0, 0.0, 0.0, 1.0)
    return pose


def _mean_twist(start: RigidMotion, end: RigidMotion, duration_s: float) -> Array:
    """log(T_start^-1 T_end) / duration, a body twist (v, omega)."""
    back = conjugate(start.orientation)
    x, y, z = to_vector(multiply(back, end.orientation))
    px, py, pz = start.position
    qx, qy, qz = end.position
    a, b, c = rotate_back(start.orientation, (qx - px, qy - py, qz - pz))
    # inverse of the left Jacobian of SO(3) by its series, exact to rounding for the turn of one interval
    squared = x * x + y * y + z * z
    k = 1.0 / 12.0 + squared / 720.0 + squared * squared / 30240.0
    ux, uy, uz = y * c - z * b, z * a - x * c, x * b - y * a
    wx, wy, wz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
    s = 1.0 / duration_s
    return np.array(
        (
            s * (a - 0.5 * ux + k * wx),
            s * (b - 0.5 * uy + k * wy),
            s * (c - 0.5 * uz + k * wz),
            s * x,
            s * y,
            s * z,
        )
    )

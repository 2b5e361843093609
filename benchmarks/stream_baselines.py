"""Other ways to follow streamed poses, to compare with: each takes samples and is asked for a motion at every tick.

The tool is ideal: it does what it is told. Each therefore keeps the tool's pose itself.
"""

from __future__ import annotations

from typing import Protocol

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import Motion
from ik_node.math.quaternion import (
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    difference,
    from_matrix,
    from_vector,
    length,
    multiply,
    normalised,
    to_vector,
)
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
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
from ik_node.targets.stream.extrapolation import resting
from ik_node.targets.stream.sampling_clock import Cadence, followed, restarted


class Follower(Protocol):
    """What :mod:`benchmarks.streams` runs; ``StreamedPoses`` is one."""

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd``."""

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """One sample."""

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The motion at ``time_ns``, and the mean twist that is commanded for ``hold_s``."""


class Proportional:
    """P control on the newest sample, held until the next: velocity = gain times error, without feed-forward.

    With ``gain = 1 / tick`` and speed bounds it is the rule "the whole error in one period, clipped".
    """

    def __init__(self, gain: float, max_linear: float = float("inf"), max_angular: float = float("inf")) -> None:
        self._gain = gain
        self._max_linear, self._max_angular = max_linear, max_angular
        self._tool = RigidMotion()
        self._goal: tuple[Vector, Quaternion] = (ZERO, (1.0, 0.0, 0.0, 0.0))
        self._promised = self._tool

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd``."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._tool = self._promised = resting((x, y, z), from_matrix(pose_sd))
        self._goal = (self._tool.position, self._tool.orientation)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """The newest arrival counts, whatever its stamp."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._goal = ((x, y, z), from_matrix(pose_sd))

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """As commanded: the tool has moved to where the last twist led."""
        tool = self._tool = self._promised
        v, w = self.velocity(tool.position, tool.orientation)
        x, y, z = tool.position
        self._promised = resting(
            (x + hold_s * v[0], y + hold_s * v[1], z + hold_s * v[2]),
            normalised(multiply(from_vector((hold_s * w[0], hold_s * w[1], hold_s * w[2])), tool.orientation)),
        )
        return Motion(pose_of(tool), mean_twist(tool, self._promised, hold_s))

    def velocity(self, position: Vector, orientation: Quaternion) -> tuple[Vector, Vector]:
        """What is asked of a tool that is there: velocity of its point and angular velocity, written in {s}."""
        return (
            self._cut(difference(self._goal[0], position), self._max_linear),
            self._cut(to_vector(multiply(self._goal[1], conjugate(orientation))), self._max_angular),
        )

    def _cut(self, error: Vector, speed: float) -> Vector:
        size = length(error)
        factor = min(self._gain, speed / size) if size > 0.0 else self._gain
        return (factor * error[0], factor * error[1], factor * error[2])


class LastSlope:
    """The same reference as ``StreamedPoses``, fed by the newest sample and the slope from the one before.

    The simplest estimator that does not lag: no choice of predictor, no removal of jitter, no latency.
    """

    def __init__(self, settings: TargetSettings) -> None:
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
        self._settings = settings
        self._tool = self._promised = RigidMotion()
        self._sample: RigidMotion | None = None
        self._stamp_ns = 0
        self._cadence = Cadence()
        self._turn = ZERO

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """At rest at ``pose_sd``."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._tool = self._promised = resting((x, y, z), from_matrix(pose_sd))

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """A sample; older ones and repeated stamps are left out."""
        x, y, z = pose_sd[:3, 3].tolist()
        orientation = from_matrix(pose_sd)
        v = w = ZERO
        if self._sample is None:
            self._cadence = restarted(self._cadence, stamped.time_ns)
        elif stamped.time_ns <= self._stamp_ns:
            return
        else:
            self._cadence = followed(self._cadence, stamped.time_ns)
            dt = max((stamped.time_ns - self._stamp_ns) / NS, 0.5 * self._cadence.period_s)
            a, b, c = difference((x, y, z), self._sample.position)
            d, e, f = to_vector(multiply(orientation, conjugate(self._sample.orientation)))
            v, w = (a / dt, b / dt, c / dt), (d / dt, e / dt, f / dt)
            if length(v) > self._linear.speed or length(w) > self._angular.speed:
                v = w = ZERO
        self._sample = RigidMotion((x, y, z), v, ZERO, orientation, w, ZERO)
        self._stamp_ns = stamped.time_ns

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """The reference, one interval on."""
        tool = self._tool = self._promised
        goal = self._sample or tool
        age_s = min((time_ns - self._stamp_ns) / NS, 2.0 * self._cadence.period_s)
        goal = move(goal, Jerk(ZERO, ZERO, age_s), age_s)
        omega = min(self._settings.bandwidth / self._cadence.period_s, self._settings.max_bandwidth)
        self._turn = orientation_error(goal.orientation, tool.orientation, self._turn)
        jerk = Jerk(
            chase(
                difference(goal.position, tool.position), tool.velocity, tool.acceleration, goal.velocity, ZERO,
                omega, self._linear, hold_s,
            ),
            chase(
                self._turn, tool.rate, tool.angular_acceleration, goal.rate, ZERO, omega, self._angular, hold_s
            ),
            hold_s,
        )  # fmt: skip
        self._promised = move(tool, jerk, hold_s)
        return Motion(pose_of(tool), mean_twist(tool, self._promised, hold_s))

"""Baselines for following streamed poses: each takes samples and returns a motion per control step.

The tool is ideal, so each follower integrates the tool pose itself.
"""

from __future__ import annotations

from typing import Protocol

from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.motion import Motion
from ik_node.math.quaternion import (
    IDENTITY,
    ZERO,
    Quaternion,
    Vector,
    conjugate,
    difference,
    from_matrix,
    from_rotation_vector,
    length,
    multiply,
    normalised,
    to_rotation_vector,
)
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.bounds import stream_bounds
from ik_node.targets.jerk_limited_filter import (
    Jerk,
    RigidMotion,
    cascade_jerk,
    integrate,
    mean_twist,
    orientation_error,
    pose_matrix,
)
from ik_node.targets.stream.cascade_gains import cascade_gains
from ik_node.targets.stream.extrapolation import resting
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated


class Follower(Protocol):
    """A follower of streamed poses; :class:`ik_node.targets.stream.stream.StreamedPoses` is one."""

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Start at rest at ``pose_sd``."""

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take one sample."""

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """Return the motion at ``time_ns`` with the mean twist that is commanded for ``hold_s``."""


class VelocityFollower:
    """An ideal tool that a subclass moves by velocities; holds the newest sample."""

    def __init__(self) -> None:
        self._tool = self._next = RigidMotion()
        self._goal: tuple[Vector, Quaternion] = (ZERO, IDENTITY)

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Start at rest at ``pose_sd``."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._tool = self._next = resting((x, y, z), from_matrix(pose_sd))
        self._goal = (self._tool.position, self._tool.orientation)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take the sample; its stamp is ignored."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._goal = ((x, y, z), from_matrix(pose_sd))

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """Return the pose that the last twist led to, and the next twist."""
        tool = self._tool = self._next
        v, w = self.command(tool.position, tool.orientation, time_ns, hold_s)
        x, y, z = tool.position
        self._next = resting(
            (x + hold_s * v[0], y + hold_s * v[1], z + hold_s * v[2]),
            normalised(multiply(from_rotation_vector((hold_s * w[0], hold_s * w[1], hold_s * w[2])), tool.orientation)),
        )
        return Motion(pose_matrix(tool), mean_twist(tool, self._next, hold_s))

    def command(self, position: Vector, orientation: Quaternion, time_ns: int, hold_s: float) -> tuple[Vector, Vector]:
        """Return the velocity of the tool point and the angular velocity, in {s}, for a tool at this pose."""
        raise NotImplementedError


class Proportional(VelocityFollower):
    """P control on the newest sample, held until the next: velocity = gain times error, without feed-forward.

    With ``gain = 1 / period`` and speed bounds it is the rule "whole error in one period, clipped".
    """

    def __init__(self, gain: float, max_linear: float = float("inf"), max_angular: float = float("inf")) -> None:
        super().__init__()
        self._gain = gain
        self._max_linear, self._max_angular = max_linear, max_angular

    def command(self, position: Vector, orientation: Quaternion, time_ns: int, hold_s: float) -> tuple[Vector, Vector]:
        """Return :meth:`velocity`, which does not depend on time."""
        return self.velocity(position, orientation)

    def velocity(self, position: Vector, orientation: Quaternion) -> tuple[Vector, Vector]:
        """Return the commanded velocity of the tool point and angular velocity, in {s}, for a tool at this pose."""
        return (
            self._cut(difference(self._goal[0], position), self._max_linear),
            self._cut(to_rotation_vector(multiply(self._goal[1], conjugate(orientation))), self._max_angular),
        )

    def _cut(self, error: Vector, speed: float) -> Vector:
        size = length(error)
        factor = min(self._gain, speed / size) if size > 0.0 else self._gain
        return (factor * error[0], factor * error[1], factor * error[2])


class LastSlope:
    """The same filter as ``StreamedPoses``, with the newest sample and the slope from the previous one as input.

    The simplest estimator without lag: no selection of predictors, no removal of jitter, no latency.
    """

    def __init__(self, settings: TargetSettings) -> None:
        self._linear, self._angular = stream_bounds(settings)
        self._tool = self._next = RigidMotion()
        self._sample: RigidMotion | None = None
        self._stamp_ns = 0
        self._sampling_clock = SamplingClock()
        self._turn = ZERO

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Start at rest at ``pose_sd``."""
        x, y, z = pose_sd[:3, 3].tolist()
        self._tool = self._next = resting((x, y, z), from_matrix(pose_sd))

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take a sample; older ones and repeated stamps are ignored."""
        x, y, z = pose_sd[:3, 3].tolist()
        orientation = from_matrix(pose_sd)
        v = w = ZERO
        if self._sample is None:
            self._sampling_clock = reset(self._sampling_clock, stamped.time_ns)
        elif stamped.time_ns <= self._stamp_ns:
            return
        else:
            self._sampling_clock = updated(self._sampling_clock, stamped.time_ns)
            dt = max((stamped.time_ns - self._stamp_ns) / NS, 0.5 * self._sampling_clock.period_s)
            a, b, c = difference((x, y, z), self._sample.position)
            d, e, f = to_rotation_vector(multiply(orientation, conjugate(self._sample.orientation)))
            v, w = (a / dt, b / dt, c / dt), (d / dt, e / dt, f / dt)
            if length(v) > self._linear.speed or length(w) > self._angular.speed:
                v = w = ZERO
        self._sample = RigidMotion((x, y, z), v, ZERO, orientation, w, ZERO)
        self._stamp_ns = stamped.time_ns

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """Return the motion of the filter after one interval."""
        tool = self._tool = self._next
        goal = self._sample or tool
        age_s = min((time_ns - self._stamp_ns) / NS, 2.0 * self._sampling_clock.period_s)
        goal = integrate(goal, Jerk(ZERO, ZERO, age_s), age_s)
        linear_gains = cascade_gains(self._sampling_clock.period_s, 0)
        angular_gains = cascade_gains(self._sampling_clock.period_s, 1)
        self._turn = orientation_error(goal.orientation, tool.orientation, self._turn)
        jerk = Jerk(
            cascade_jerk(
                difference(goal.position, tool.position), tool.velocity, tool.acceleration, goal.velocity, ZERO,
                *linear_gains, self._linear, hold_s,
            ),
            cascade_jerk(
                self._turn, tool.rate, tool.angular_acceleration, goal.rate, ZERO,
                *angular_gains, self._angular, hold_s,
            ),
            hold_s,
        )  # fmt: skip
        self._next = integrate(tool, jerk, hold_s)
        return Motion(pose_matrix(tool), mean_twist(tool, self._next, hold_s))

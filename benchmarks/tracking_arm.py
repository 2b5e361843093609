"""An arm behind a follower of streams: the node's whole controller or a rival leads it, in simulated time.

So :func:`benchmarks.streams.follow` runs an arm with its lag, delay and noise as it runs an ideal tool, and
figures are those of the tool where it truly was.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from benchmarks.stream_baselines import Proportional
from ik_node.control.controller import Controller
from ik_node.differential_ik.closed_form import resolve
from ik_node.interfaces.clock import NS, Instant, Stamped
from ik_node.interfaces.motion import Motion
from ik_node.interfaces.samples import JointSample, PathSample, PoseSample, TrajectorySample
from ik_node.math import se3
from ik_node.math.quaternion import from_matrix
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.settings.groups import Settings

BEGIN_NS = 10 * NS
"""What the monotonic clock shows at time 0."""
ROS_OFFSET_NS = 1_700_000_000 * NS
"""ROS time when the monotonic clock shows 0."""
TICKS_BEFORE = 5
"""Ticks at rest before time 0."""


class Simulator(NamedTuple):
    """An arm to be led."""

    name: str
    lag_s: float = 0.0
    delayed: bool = False
    """By one sample."""
    noise: float = 0.0
    """Of the encoders, rad."""
    seed: int = 0

    def model(self, period_s: float) -> ArmModel:
        """With joint states every ``period_s``."""
        return ArmModel(self.lag_s, period_s if self.delayed else 0.0, self.noise, seed=self.seed)


class Leader(Protocol):
    """From measured joints and targets to joint velocities."""

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """The arm rests at q (n,), its tool at ``pose_sb``."""

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """A sample of the target; times are on the monotonic clock."""

    def velocity(self, q: Array, now: Instant) -> Array:
        """Commanded joint velocity (n,) at measured q."""


class ArmFollower:
    """Follows a stream with an arm; ``velocities`` holds the commands, one for each tick."""

    def __init__(self, robot: Robot, q: Array, simulator: Simulator, leader: Leader, rate_hz: float) -> None:
        """``q`` (n,): where the arm rests at time 0, rad (m)."""
        self._robot, self._leader = robot, leader
        self._period_ns = round(NS / rate_hz)
        begin_ns = BEGIN_NS - (TICKS_BEFORE + 1) * self._period_ns
        self._arm = SimulatedArm(q, robot.limits, begin_ns, simulator.model(1.0 / rate_hz))
        self._start = q
        self.velocities: list[Array] = []

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """The arm stands where it stands; the leader gets to know it."""
        now_ns = BEGIN_NS + time_ns - TICKS_BEFORE * self._period_ns
        self._leader.start(self._start, self._robot.pose(self._start), _instant(now_ns))
        for _ in range(TICKS_BEFORE):
            self._tick(now_ns)
            now_ns += self._period_ns

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Handed on."""
        time_ns, received_ns, skew_ns = stamped
        self._leader.add(pose_sd, Stamped(BEGIN_NS + time_ns, BEGIN_NS + received_ns, skew_ns))

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """Where the tool truly is, and the twist that the command gives it."""
        q, command = self._tick(BEGIN_NS + time_ns)
        self.velocities.append(command)
        state = self._robot.evaluate(q)
        return Motion(state.pose_sb, state.jacobian_b @ command)

    def _tick(self, now_ns: int) -> tuple[Array, Array]:
        measured = self._arm.measure(now_ns)
        q, _ = self._arm.advance(now_ns)
        command = self._leader.velocity(q if measured is None else measured, _instant(now_ns))
        self._arm.command(command, now_ns)
        return q, command


def _instant(monotonic_ns: int) -> Instant:
    return Instant(monotonic_ns, monotonic_ns + ROS_OFFSET_NS)


class Node:
    """The controller as the node runs it, fed with what arrives."""

    def __init__(self, robot: Robot, settings: Settings, known: PathSample | TrajectorySample | None = None) -> None:
        """``known``: what to follow instead of a stream; its stamps count from time 0."""
        self._robot = robot
        self._controller = Controller(robot, settings)
        self._known = known
        self.slowed = 0
        """Ticks at which limits or a singularity took a part of the twist."""
        self.stopped = 0
        """Ticks at which no control law was at work."""

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """One joint state closes the loop; a target that is known as a whole is sent before it begins."""
        before = Instant(now.monotonic_ns - 1_000_000, now.ros_ns - 1_000_000)
        self._controller.on_joint_state(JointSample(before.ros_ns, self._robot.joints, q), before)
        zero_ns = BEGIN_NS + ROS_OFFSET_NS
        if isinstance(self._known, PathSample):
            stamps = tuple(zero_ns + stamp for stamp in self._known.stamps_ns)
            self._controller.on_target_path(self._known._replace(stamps_ns=stamps), before)
        elif self._known is not None:
            self._controller.on_target_trajectory(self._known._replace(stamp_ns=zero_ns), before)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """A message that arrives; where the arrival is all there is, it has no stamp."""
        if self._known is not None:
            return
        time_ns, received_ns, _ = stamped
        stamp_ns = 0 if time_ns == received_ns else time_ns + ROS_OFFSET_NS
        quaternion = se3.quaternion_from_rotation(pose_sd[:3, :3])
        sample = PoseSample(stamp_ns, self._robot.base_frame, pose_sd[:3, 3], quaternion)
        self._controller.on_target_pose(sample, _instant(received_ns))

    def velocity(self, q: Array, now: Instant) -> Array:
        """Of the Step."""
        step = self._controller.on_joint_state(JointSample(now.ros_ns, self._robot.joints, q), now)
        if step is None:
            self.stopped += 1
            return np.zeros(self._robot.n)
        self.slowed += step.scale < 1.0
        self.stopped += bool(np.isnan(step.scale))
        return step.joint_velocity


class Rival:
    """P control on the newest pose through the pseudoinverse; slowed down by the joints' velocity limits alone."""

    def __init__(self, robot: Robot, law: Proportional) -> None:
        self._robot, self._law = robot, law

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """At rest."""
        self._law.start(pose_sb, now.monotonic_ns)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """The newest arrival counts."""
        self._law.add(pose_sd, stamped)

    def velocity(self, q: Array, now: Instant) -> Array:
        """The law's twist, written in {b}, through J_b."""
        state = self._robot.evaluate(q)
        rotation = state.pose_sb[:3, :3]
        x, y, z = state.pose_sb[:3, 3].tolist()
        v, w = self._law.velocity((x, y, z), from_matrix(state.pose_sb))
        twist_b = np.concatenate((np.array(v) @ rotation, np.array(w) @ rotation))
        velocity = resolve(state.jacobian_b, twist_b, checked=True).joint_velocity
        return np.asarray(velocity / max(1.0, float((np.abs(velocity) / self._robot.limits.velocity).max())))

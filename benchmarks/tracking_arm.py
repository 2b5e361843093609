"""A simulated arm as a follower of streams, controlled by the controller of the node or by a baseline.

:func:`benchmarks.stream_metrics.follow` therefore runs an arm with lag, delay and noise like an ideal tool; the figures
are those of the true tool pose.
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
"""Monotonic time at time 0."""
ROS_OFFSET_NS = 1_700_000_000 * NS
"""ROS time at monotonic time 0."""
STEPS_BEFORE = 5
"""Control steps at rest before time 0."""


class ArmVariant(NamedTuple):
    """Model of an arm."""

    name: str
    lag_s: float = 0.0
    delayed: bool = False
    """Delay of one sample."""
    noise: float = 0.0
    """Standard deviation of the encoders, rad."""
    seed: int = 0

    def model(self, period_s: float) -> ArmModel:
        """Return the model for joint states every ``period_s``."""
        return ArmModel(self.lag_s, period_s if self.delayed else 0.0, self.noise, seed=self.seed)


class JointController(Protocol):
    """Computes joint velocities from measured joint positions and targets."""

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """Start with the arm at rest at q (n,), its tool at ``pose_sb``."""

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take a sample of the target; times are monotonic."""

    def velocity(self, q: Array, now: Instant) -> Array:
        """Return the commanded joint velocity (n,) for measured q."""


class ArmFollower:
    """Follows a stream with an arm; ``velocities`` are the commands, one per control step."""

    def __init__(
        self, robot: Robot, q: Array, simulator: ArmVariant, controller: JointController, rate_hz: float
    ) -> None:
        """``q`` (n,): joint positions at rest at time 0, rad (m)."""
        self._robot, self._controller = robot, controller
        self._period_ns = round(NS / rate_hz)
        begin_ns = BEGIN_NS - (STEPS_BEFORE + 1) * self._period_ns
        self._arm = SimulatedArm(q, robot.limits, begin_ns, simulator.model(1.0 / rate_hz))
        self._start = q
        self.velocities: list[Array] = []

    def start(self, pose_sd: Array, time_ns: int) -> None:
        """Start the controller with the arm at rest."""
        now_ns = BEGIN_NS + time_ns - STEPS_BEFORE * self._period_ns
        self._controller.start(self._start, self._robot.pose(self._start), _instant(now_ns))
        for _ in range(STEPS_BEFORE):
            self._step(now_ns)
            now_ns += self._period_ns

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Pass the sample to the controller."""
        time_ns, received_ns, skew_ns = stamped
        self._controller.add(pose_sd, Stamped(BEGIN_NS + time_ns, BEGIN_NS + received_ns, skew_ns))

    def advance(self, time_ns: int, hold_s: float) -> Motion:
        """Return the true tool pose and the twist of the command."""
        q, command = self._step(BEGIN_NS + time_ns)
        self.velocities.append(command)
        state = self._robot.evaluate(q)
        return Motion(state.pose_sb, state.jacobian_b @ command)

    def _step(self, now_ns: int) -> tuple[Array, Array]:
        measured = self._arm.measure(now_ns)
        q, _ = self._arm.advance(now_ns)
        command = self._controller.velocity(q if measured is None else measured, _instant(now_ns))
        self._arm.command(command, now_ns)
        return q, command


def _instant(monotonic_ns: int) -> Instant:
    return Instant(monotonic_ns, monotonic_ns + ROS_OFFSET_NS)


class NodeController:
    """The controller of the node."""

    def __init__(self, robot: Robot, settings: Settings, known: PathSample | TrajectorySample | None = None) -> None:
        """``known``: target instead of a stream; its stamps count from time 0."""
        self._robot = robot
        self._controller = Controller(robot, settings)
        self._known = known
        self.slowed = 0
        """Control steps with s < 1."""
        self.stopped = 0
        """Control steps without control."""

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """Close the loop with one joint state; send a known target before it begins."""
        before = Instant(now.monotonic_ns - 1_000_000, now.ros_ns - 1_000_000)
        self._controller.on_joint_state(JointSample(before.ros_ns, self._robot.joints, q), before)
        zero_ns = BEGIN_NS + ROS_OFFSET_NS
        if isinstance(self._known, PathSample):
            stamps = tuple(zero_ns + stamp for stamp in self._known.stamps_ns)
            self._controller.on_target_path(self._known._replace(stamps_ns=stamps), before)
        elif self._known is not None:
            self._controller.on_target_trajectory(self._known._replace(stamp_ns=zero_ns), before)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Add a target; without a stamp if only its time of arrival is known."""
        if self._known is not None:
            return
        time_ns, received_ns, _ = stamped
        stamp_ns = 0 if time_ns == received_ns else time_ns + ROS_OFFSET_NS
        quaternion = se3.quaternion_from_rotation(pose_sd[:3, :3])
        sample = PoseSample(stamp_ns, self._robot.base_frame, pose_sd[:3, 3], quaternion)
        self._controller.on_target_pose(sample, _instant(received_ns))

    def velocity(self, q: Array, now: Instant) -> Array:
        """Return the joint velocity of the Step."""
        step = self._controller.on_joint_state(JointSample(now.ros_ns, self._robot.joints, q), now)
        if step is None:
            self.stopped += 1
            return np.zeros(self._robot.n)
        self.slowed += step.scale < 1.0
        self.stopped += bool(np.isnan(step.scale))
        return step.joint_velocity


class BaselineController:
    """P control on the newest pose through the pseudoinverse, scaled to the velocity limits."""

    def __init__(self, robot: Robot, feedback: Proportional) -> None:
        self._robot, self._feedback = robot, feedback

    def start(self, q: Array, pose_sb: Array, now: Instant) -> None:
        """Start at rest."""
        self._feedback.start(pose_sb, now.monotonic_ns)

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take the sample."""
        self._feedback.add(pose_sd, stamped)

    def velocity(self, q: Array, now: Instant) -> Array:
        """Return the joint velocity for the twist of P control, scaled to the limits."""
        state = self._robot.evaluate(q)
        rotation = state.pose_sb[:3, :3]
        x, y, z = state.pose_sb[:3, 3].tolist()
        v, w = self._feedback.velocity((x, y, z), from_matrix(state.pose_sb))
        twist_b = np.concatenate((np.array(v) @ rotation, np.array(w) @ rotation))
        velocity = resolve(state.jacobian_b, twist_b, checked=True).joint_velocity
        return np.asarray(velocity / max(1.0, float((np.abs(velocity) / self._robot.limits.velocity).max())))

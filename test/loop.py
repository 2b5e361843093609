"""Controller and simulated arm in one process, in simulated time, for closed-loop tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ik_node.control.controller import Controller
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import JointSample, PoseSample
from ik_node.interfaces.step import Mode, Step
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import ArmModel, SimulatedArm
from ik_node.settings.groups import ArmSettings, Settings

READY = {
    "panda": (0.0, -0.785398, 0.0, -2.356194, 0.0, 1.570796, 0.785398),
    "ur5": (0.0, -1.2, 1.6, -1.97, -1.57, 0.0),
}
ROS_OFFSET_NS = 1_700_000_000 * NS
"""ROS time at monotonic time 0."""


def make_robot(name: str) -> Robot:
    """An arm of example-robot-data."""
    return catalogue.robot_from_settings(ArmSettings(robot=name))


class Loop:
    """Each period of ``1 / rate_hz`` the arm moves, the controller gets a joint state and the arm its command."""

    def __init__(
        self,
        robot: Robot,
        start: tuple[float, ...] | Array,
        settings: Settings | None = None,
        model: ArmModel | None = None,
    ) -> None:
        self.robot = robot
        self.settings = settings or Settings()
        self.controller = Controller(robot, self.settings)
        self.time_ns = NS
        self.arm = SimulatedArm(np.array(start), robot.limits, self.time_ns, model)
        self.steps: list[Step] = []
        self.period_ns = round(NS / self.settings.control.rate_hz)

    @property
    def now(self) -> Instant:
        """Present time."""
        return Instant(self.time_ns, self.time_ns + ROS_OFFSET_NS)

    @property
    def position(self) -> Array:
        """Joint positions of the arm."""
        return self.arm.advance(self.time_ns)[0]

    def mode(self) -> Mode:
        """Mode of the controller."""
        return self.controller.status.mode

    def pose(self) -> Array:
        """T_sb of the arm."""
        return self.robot.pose(self.position)

    def tick(self) -> Step | None:
        """Runs one period."""
        self.time_ns += self.period_ns
        measured = self.arm.measure(self.time_ns)
        if measured is None:
            return None
        sample = JointSample(self.now.ros_ns, self.robot.joints, measured)
        return self.take(self.controller.on_joint_state(sample, self.now))

    def take(self, step: Step | None) -> Step | None:
        """Sends the command of a step to the arm."""
        if step is not None:
            self.arm.command(step.joint_velocity, self.time_ns)
            self.steps.append(step)
        return step

    def run(self, duration_s: float, each: Callable[[], None] | None = None) -> None:
        """Runs for ``duration_s``; ``each`` is called before every period."""
        for _ in range(round(duration_s * NS / self.period_ns)):
            if each is not None:
                each()
            self.tick()

    def target(self, pose_sd: Array, stamp_ns: int | None = None, frame_id: str | None = None) -> None:
        """Sends a target pose, by default with the present stamp in the base frame."""
        stamp = self.now.ros_ns if stamp_ns is None else stamp_ns
        frame = self.robot.base_frame if frame_id is None else frame_id
        quaternion = se3.quaternion_from_rotation(pose_sd[:3, :3])
        self.controller.on_target_pose(PoseSample(stamp, frame, pose_sd[:3, 3], quaternion), self.now)

    def follow(self, pose: Callable[[float], Array], duration_s: float, target_rate_hz: float) -> None:
        """Runs while streaming ``pose(t)`` at a rate."""
        begin_ns, sent = self.time_ns, 0

        def send() -> None:
            nonlocal sent
            elapsed_s = (self.time_ns - begin_ns) / NS
            if elapsed_s >= sent / target_rate_hz - 1e-9:
                self.target(pose(elapsed_s))
                sent += 1

        self.run(duration_s, send)

"""A run in simulation before the first real one, so that nothing is compiled while an arm moves.

What :mod:`ik_node.compiled` compiles, it compiles when it is first needed, which takes seconds; once it is kept on disk
it is fetched in milliseconds, still too long for a tick. So a controller of the same robot and settings goes through
what controllers go through: every method, every kind of target, obstacles, limits that bind, targets out of reach.
"""

from __future__ import annotations

import contextlib

import numpy as np

from ik_node.clock import NS, Instant
from ik_node.compiled import compilations
from ik_node.controller import Controller
from ik_node.errors import IkNodeError
from ik_node.inputs import JointSample, ObstacleSample, PathSample, PoseSample, TwistSample
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import METHODS, Settings, Value
from ik_node.simulator import SimulatedArm

TICKS = 20
"""Of every scene."""
OUT_OF_REACH_M = 10.0
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def rehearse(robot: Robot, settings: Settings) -> int:
    """Goes through all of it with a controller of its own; returns how many functions had to be fetched or compiled."""
    before = compilations()
    rehearsal = _Rehearsal(robot, settings)
    for method in METHODS:
        rehearsal.change({"method": method, "control_law": "twist_feedback"})
        rehearsal.stream(0.001)
        rehearsal.path()
        rehearsal.jog()
        rehearsal.obstacle(0.1)
        rehearsal.stream(OUT_OF_REACH_M)
    rehearsal.change({"arm_lag_s": 0.02, "gain_integral_linear": 0.1})
    rehearsal.stream(0.001)
    rehearsal.change({"control_law": "ik_difference"})
    rehearsal.stream(0.001)
    return compilations() - before


class _Rehearsal:
    """A controller, a simulated arm and a clock that nobody waits for."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        self._robot, self._settings = robot, settings
        self._controller = Controller(robot, settings)
        self._period_ns = round(NS / settings.control.rate_hz)
        self._time_ns = NS
        lower, upper = robot.limits.lower, robot.limits.upper
        bounded = np.isfinite(lower) & np.isfinite(upper)
        middle = np.where(bounded, 0.5 * (np.where(bounded, lower, 0.0) + np.where(bounded, upper, 0.0)), 0.1)
        self._arm = SimulatedArm(middle, robot.limits, self._time_ns)

    @property
    def _now(self) -> Instant:
        return Instant(self._time_ns, self._time_ns)

    @property
    def _point(self) -> Array:
        return self._robot.pose(self._arm.advance(self._time_ns)[0])[:3, 3]

    def change(self, values: dict[str, Value]) -> None:
        """Other settings from now on."""
        self._settings = self._settings.with_values(values)
        self._controller.apply(self._settings)

    def _ticks(self, count: int = TICKS) -> None:
        for _ in range(count):
            self._time_ns += self._period_ns
            measured = self._arm.advance(self._time_ns)[0]
            step = self._controller.on_joint_state(JointSample(0, self._robot.joints, measured), self._now)
            if step is not None:
                self._arm.command(step.joint_velocity, self._time_ns)
        self._controller.reset()

    def stream(self, step_m: float) -> None:
        """Poses, each this much further; then silence."""
        self._ticks(2)
        for count in range(6):
            with contextlib.suppress(IkNodeError):
                point = self._point + count * step_m
                self._controller.on_target_pose(PoseSample(0, self._robot.base_frame, point, UPRIGHT), self._now)
            self._ticks(TICKS // 2)
        self._ticks()

    def path(self) -> None:
        """Two poses and their times."""
        frames, stamps = (self._robot.base_frame,) * 2, (self._time_ns, self._time_ns + NS)
        points = np.stack((self._point, self._point + 0.01))
        with contextlib.suppress(IkNodeError):
            sample = PathSample(frames, stamps, points, np.stack((UPRIGHT, UPRIGHT)))
            self._controller.on_target_path(sample, self._now)
        self._ticks()

    def jog(self) -> None:
        """A twist."""
        with contextlib.suppress(IkNodeError):
            sample = TwistSample(0, self._robot.base_frame, np.full(6, 0.1))
            self._controller.on_target_twist(sample, self._now)
        self._ticks()

    def obstacle(self, distance_m: float) -> None:
        """A ball that comes from this far, and goes."""
        for part in (1.0, 0.5, 0.0):
            point = self._point + part * distance_m
            self._put(ObstacleSample(0, self._robot.base_frame, "ball", "add", "sphere", (0.05,), point, UPRIGHT, 0))
            self._ticks()
        self._put(ObstacleSample(0, "", "ball", "delete", "", (), np.zeros(3), UPRIGHT, 0))

    def _put(self, sample: ObstacleSample) -> None:
        with contextlib.suppress(IkNodeError):
            self._controller.on_obstacles((sample,), self._now)

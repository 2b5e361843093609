"""A run in simulation before the first real one, so that nothing is compiled while an arm moves.

What :mod:`ik_node.jit` compiles, it compiles when it is first needed, which takes seconds; once it is kept on disk
it is fetched in milliseconds, still too long for a tick. So a controller of the same robot and settings goes through
what controllers go through: every method, every kind of target, obstacles, limits that bind, targets out of reach.
"""

from __future__ import annotations

import contextlib

import numpy as np

from ik_node.control.controller import Controller
from ik_node.differential_ik.manipulability import dexterity
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import (
    JointSample,
    ObstacleSample,
    PathSample,
    PoseSample,
    TrajectorySample,
    TwistSample,
)
from ik_node.jit import compilation_count, mark_warm
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import METHODS, Settings, Value

TICKS = 20
"""Of every scene."""
SAMPLES = 12
"""Of a stream: enough for its predictors to be compared."""
OUT_OF_REACH_M = 10.0
NEARBY_M = 0.02
NOTHING = np.zeros((0, 6))


def rehearse(robot: Robot, settings: Settings) -> int:
    """Goes through all of it with a controller of its own; returns how many functions had to be fetched or compiled."""
    before = compilation_count()
    rehearsal = _Rehearsal(robot, settings)
    for method in METHODS:
        rehearsal.change({"method": method, "control_law": "twist_feedback"})
        rehearsal.obstacle(0.1)
        rehearsal.stream(OUT_OF_REACH_M, 2)
    rehearsal.stream(0.001, SAMPLES)
    rehearsal.paths()
    rehearsal.jog()
    dampers = {"obstacles.damper": not settings.obstacles.damper}
    rehearsal.change({"arm_lag_s": 0.02, "gain_integral_linear": 0.1, **dampers})
    rehearsal.stream(0.001, 2)
    rehearsal.obstacle(0.1)
    rehearsal.change({"control_law": "ik_difference"})
    rehearsal.stream(0.001, 2)
    rehearsal.change({"control_law": "twist_feedback", "jacobian": "space"})
    rehearsal.stream(0.001, 2)
    rehearsal.singular_start()
    mark_warm()
    return compilation_count() - before


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

    def _tool(self) -> tuple[Array, Array]:
        """Where the tool is: point (3,), quaternion (4,)."""
        pose = self._robot.pose(self._arm.advance(self._time_ns)[0])
        return pose[:3, 3], se3.quaternion_from_rotation(pose[:3, :3])

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

    def stream(self, step_m: float, samples: int) -> None:
        """Poses, each this much further; then silence."""
        self._ticks(2)
        for count in range(samples):
            point, quaternion = self._tool()
            with contextlib.suppress(IkNodeError):
                sample = PoseSample(0, self._robot.base_frame, point + count * step_m, quaternion)
                self._controller.on_target_pose(sample, self._now)
            self._ticks(TICKS // 2)
        self._ticks()

    def paths(self) -> None:
        """Paths with and without times, from where the tool is and from nearby; a trajectory."""
        base = self._robot.base_frame
        for away_m in (0.0, NEARBY_M):
            point, quaternion = self._tool()
            points = np.stack((point, point + 0.5 * NEARBY_M, point + NEARBY_M)) + away_m
            quaternions = np.stack((quaternion, quaternion, quaternion))
            times_ns = (0, NS // 4, NS // 2)
            timed = PathSample((base,) * 3, tuple(self._time_ns + time_ns for time_ns in times_ns), points, quaternions)
            untimed = timed._replace(stamps_ns=(0, 0, 0))
            twists = np.full((3, 6), 0.01)
            for sample in (timed, untimed):
                with contextlib.suppress(IkNodeError):
                    self._controller.on_target_path(sample, self._now)
                self._ticks()
            for given in ((NOTHING, NOTHING), (twists, NOTHING), (twists, twists)):
                trajectory = TrajectorySample(self._time_ns, base, times_ns, points, quaternions, *given)
                with contextlib.suppress(IkNodeError):
                    self._controller.on_target_trajectory(trajectory, self._now)
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
            point, quaternion = self._tool()
            place = point + part * distance_m
            self._put(ObstacleSample(0, self._robot.base_frame, "ball", "add", "sphere", (0.05,), place, quaternion, 0))
            self._ticks()
        self._put(ObstacleSample(0, "", "ball", "delete", "", (), np.zeros(3), np.zeros(4), 0))

    def singular_start(self) -> None:
        """What an arm with a null space does if it starts in a singularity."""
        q = self._arm.advance(self._time_ns)[0]
        dexterity(lambda there: self._robot.evaluate(there).jacobian_b, q, np.ones(6), 1.0, np.inf)

    def _put(self, sample: ObstacleSample) -> None:
        with contextlib.suppress(IkNodeError):
            self._controller.on_obstacles((sample,), self._now)

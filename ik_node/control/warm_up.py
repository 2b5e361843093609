"""Warm-up: a simulated run before the first real one, so that no function is compiled while the arm moves.

:mod:`ik_node.jit` compiles a function at its first call, which takes seconds. Loading it from the cache on disk takes
milliseconds, still too long for a control step. Therefore a second controller with the same robot and settings calls
every compiled function: every method, every kind of target, obstacles, active limits, targets out of reach,
singularities, joint states that are refused.
"""

from __future__ import annotations

import contextlib
from math import inf

import numpy as np

from ik_node.control.controller import Controller
from ik_node.differential_ik.manipulability import manipulability_potential
from ik_node.errors import IkNodeError, SettingsError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import (
    JointSample,
    ObstacleSample,
    PathSample,
    PoseSample,
    TrajectorySample,
    TwistSample,
)
from ik_node.jit import compilation_count
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.robot.simulated_arm import SimulatedArm
from ik_node.settings.groups import Settings
from ik_node.settings.method_names import METHOD_NAMES
from ik_node.settings.schema import Value

STEPS = 6
"""Control steps per scenario."""
SAMPLES = 12
"""Poses of a stream; enough for the comparison of its predictors."""
OUT_OF_REACH_M = 10.0
NEARBY_M = 0.02
TOLERANCES = ((0.0, 0.0, 0.0, inf, inf, 0.0), (0.01, 0.0, 0.0, 0.1, 0.1, inf), (0.0, 0.0, 0.0, 0.0, 0.0, inf))
"""Tasks of each form."""
NO_ROWS = np.zeros((0, 6))


def warm_up(robot: Robot, settings: Settings) -> int:
    """Calls every compiled function of the control loop once.

    Args:
        robot: The arm.
        settings: Settings of the real controller.

    Returns:
        The number of functions that were loaded or compiled.
    """
    count = compilation_count()
    # The file of the scene may be on another computer, if the settings are recorded ones.
    run = _SimulatedRun(robot, settings.with_values({"obstacles.scene": ""}))
    run.paths()  # first, while the reference is where the arm is: only then does the arm move along them
    for method in METHOD_NAMES:
        try:
            run.change({"method": method, "control_law": "twist_feedback"})
        except SettingsError:  # a massless arm can use one method only
            continue
        run.obstacle(0.1)
        run.stream(OUT_OF_REACH_M, 2)
    run.stream(0.001, SAMPLES)
    run.jog()
    dampers = {"obstacles.velocity_damper": not settings.obstacles.velocity_damper}
    run.change({"arm_lag_s": 0.02, "integral_gain": (0.1, 0.0), **dampers})
    run.stream(0.001, 2)
    run.obstacle(0.1)
    run.change({"control_law": "ik_difference"})
    run.stream(0.001, 2)
    run.change({"control_law": "twist_feedback"})
    run.stream(0.001, 2)
    for tolerance in TOLERANCES:
        run.change({"task.tolerance": tolerance})
        run.stream(0.001, 2)
    run.jog()
    run.jump()
    # Large arms are singular nowhere near their middle with the default threshold.
    run.change({"task.tolerance": (0.0,) * 6, "singularity.threshold": 1.0, "singularity.tolerance": 0.1})
    run.stream(OUT_OF_REACH_M, 2)
    run.singular_start()
    return compilation_count() - count


class _SimulatedRun:
    """A controller with a simulated arm, faster than real time."""

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
        """Pose of the tool: point (3,), m, and quaternion (4,)."""
        pose = self._robot.pose(self._arm.advance(self._time_ns)[0])
        return pose[:3, 3], se3.quaternion_from_rotation(pose[:3, :3])

    def change(self, values: dict[str, Value]) -> None:
        """Applies changed settings."""
        settings = self._settings.with_values(values)
        self._controller.apply(settings)
        self._settings = settings

    def _run_steps(self, count: int = STEPS) -> None:
        for _ in range(count):
            self._time_ns += self._period_ns
            measured = self._arm.advance(self._time_ns)[0]
            step = self._controller.on_joint_state(JointSample(0, self._robot.joints, measured), self._now)
            if step is not None:
                self._arm.command(step.joint_velocity, self._time_ns)
        self._controller.reset()

    def jump(self) -> None:
        """Measures joint positions that are not possible after the last ones."""
        self._run_steps(2)
        measured = self._arm.advance(self._time_ns)[0]
        for offset in (1.0, 0.0):
            self._time_ns += self._period_ns
            self._controller.on_joint_state(JointSample(0, self._robot.joints, measured + offset), self._now)
        self._controller.reset()

    def stream(self, step_m: float, samples: int) -> None:
        """Streams poses, each ``step_m`` further than the last, and then pauses."""
        self._run_steps(2)
        for count in range(samples):
            point, quaternion = self._tool()
            with contextlib.suppress(IkNodeError):
                sample = PoseSample(0, self._robot.base_frame, point + count * step_m, quaternion)
                self._controller.on_target_pose(sample, self._now)
            self._run_steps(STEPS // 2)
        self._run_steps()

    def paths(self) -> None:
        """Follows paths with and without times, from the tool's pose and from nearby, and trajectories."""
        base = self._robot.base_frame
        self._run_steps(2)
        for distance_m in (0.0, NEARBY_M):
            point, quaternion = self._tool()
            points = np.stack((point, point + 0.5 * NEARBY_M, point + NEARBY_M)) + distance_m
            quaternions = np.stack((quaternion, quaternion, quaternion))
            times_ns = (0, NS // 4, NS // 2)
            begin_ns = self._time_ns + 2 * self._period_ns  # a later begin is reached, and the arm moves along the path
            stamps_ns = tuple(begin_ns + time_ns for time_ns in times_ns)
            timed = PathSample((base,) * 3, stamps_ns, points, quaternions)
            untimed = timed._replace(stamps_ns=(0, 0, 0))
            twists = np.full((3, 6), 0.01)
            for sample in (timed, untimed):
                with contextlib.suppress(IkNodeError):
                    self._controller.on_target_path(sample, self._now)
                self._run_steps()
            for derivatives in ((NO_ROWS, NO_ROWS), (twists, NO_ROWS), (twists, twists)):
                trajectory = TrajectorySample(self._time_ns, base, times_ns, points, quaternions, *derivatives)
                with contextlib.suppress(IkNodeError):
                    self._controller.on_target_trajectory(trajectory, self._now)
                self._run_steps()

    def jog(self) -> None:
        """Jogs with a twist."""
        with contextlib.suppress(IkNodeError):
            sample = TwistSample(0, self._robot.base_frame, np.full(6, 0.1))
            self._controller.on_target_twist(sample, self._now)
        self._run_steps()

    def obstacle(self, distance_m: float) -> None:
        """Adds a sphere at this distance, moves it to the tool, and deletes it."""
        for ratio in (1.0, 0.5, 0.0):
            point, quaternion = self._tool()
            centre = point + ratio * distance_m
            self._put(
                ObstacleSample(0, self._robot.base_frame, "ball", "add", "sphere", (0.05,), centre, quaternion, 0)
            )
            self._run_steps()
        self._put(ObstacleSample(0, "", "ball", "delete", "", (), np.zeros(3), np.zeros(4), 0))

    def singular_start(self) -> None:
        """Evaluates the manipulability potential, used by redundant arms that start in a singularity."""
        q = self._arm.advance(self._time_ns)[0]
        manipulability_potential(lambda there: self._robot.evaluate(there).jacobian_b, q, np.ones(6), 1.0, np.inf)

    def _put(self, sample: ObstacleSample) -> None:
        with contextlib.suppress(IkNodeError):
            self._controller.on_obstacles((sample,), self._now)

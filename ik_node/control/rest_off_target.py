"""Status of an arm at rest off a pose at rest: what holds it, and whether other joint positions reach the pose.

The differential inverse kinematics follows the error of the pose. At a limit or a singularity it can end where no small
motion reduces the error, although joint positions on another branch reach the pose: an elbow at its limit on one side
of the stretched posture would have to bend to the other. The arm stays there, because a motion to these positions would
lead the tool away. The status names the distance, the limits and the joints of the singularity. Inverse kinematics
searches from :data:`STARTS` starts, once per pose and :data:`ITERATIONS` iterations in each control step, and the
status names what it found.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.differential_ik.solution import DifferentialIkSolution
from ik_node.interfaces.clock import NS
from ik_node.interfaces.motion import Motion
from ik_node.inverse_kinematics.newton_raphson import TerminationReason
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.jit import compiled
from ik_node.math.numerics import low_discrepancy_points
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.joint_limits import MotionLimits
from ik_node.robot.robot import Robot

REFERENCE_M_S, REFERENCE_RAD_S = 1e-3, 5e-3
"""A reference below these speeds is at rest."""
MIN_ERROR_M = 1e-4
"""Least error that is reported, m; rotations count with the characteristic length."""
PROGRESS = 0.95
"""The arm makes progress while its error falls below this fraction of the least one so far ..."""
REST_S = 2.5
"""... and is at rest after this time without progress, longer than a deadlock lasts until its release, s."""
REST_FRACTION = 0.02
"""Fraction of all velocity limits below which the arm is at rest."""
STARTS, RANGE_STARTS = 12, 4
"""Starts of the search: the present position, positions around it, and the last ones in the whole range."""
SPREAD = 1.0
"""Largest distance of the positions around the present one, rad (m)."""
ITERATIONS, CALLS_PER_START = 3, 10
"""Iterations in one control step, about 0.1 ms, and control steps for one start."""
PARTICIPATION = 0.3
"""Entry of a singular direction, a unit vector, from which a joint is named."""


class RestSnapshot(NamedTuple):
    """Attributes of a :class:`RestOffTarget`."""

    least_m: float = np.inf
    since_ns: int = 0
    begin: Array | None = None
    seed: Array | None = None
    start: int = 0
    calls: int = 0
    text: str = ""


class RestOffTarget:
    """Detects that the arm rests off its target, and searches joint positions that reach it."""

    def __init__(self, robot: Robot, tolerance: TaskTolerance, locked: tuple[str, ...] = ()) -> None:
        self._robot = robot
        self.configure(tolerance, locked)

    def configure(self, tolerance: TaskTolerance, locked: tuple[str, ...] = ()) -> None:
        """Applies another tolerance and locked joints."""
        self._solver = PoseSolver(
            self._robot, search_iterations=ITERATIONS, tolerance=tolerance, compared_searches=1, locked=locked
        )
        self._is_locked = np.isin(self._robot.joints, locked)
        self.reset()

    def reset(self) -> None:
        """Forgets the pose."""
        self.least_m, self.since_ns = np.inf, 0
        self.begin: Array | None = None
        """Joint positions at which the arm came to rest, (n,)."""
        self.seed: Array | None = None
        """Joint positions from which the search continues, (n,); None when there is nothing to search."""
        self.start = 0
        """Index of the start of the search."""
        self.calls = 0
        """Control steps since that start."""
        self.text = ""
        """Status text; empty while the arm is not at rest off its target."""

    def update(
        self,
        q: Array,
        motion: Motion,
        error_b: Array,
        solution: DifferentialIkSolution,
        limits: MotionLimits,
        row_scale: Array,
        time_ns: int,
    ) -> None:
        """Evaluates a control step.

        Args:
            q: Joint positions, (n,), rad (m).
            motion: Reference.
            error_b: Error of the pose, (6,), m and rad, in {b}.
            solution: The command of this step.
            limits: Limits of the joints.
            row_scale: D, (6,).
            time_ns: Monotonic time.
        """
        error_m, is_moving = _error_and_motion(error_b, row_scale, motion.twist_d)
        if error_m < MIN_ERROR_M or is_moving:
            if self.since_ns:
                self.reset()
        elif error_m < PROGRESS * self.least_m:
            self.reset()
            self.least_m, self.since_ns = error_m, time_ns
        elif self.seed is not None and self.begin is not None:
            self._search(motion.pose_sd, self.begin, self.seed)
        elif not self.text and time_ns - self.since_ns >= REST_S * NS:
            at_rest = bool((np.abs(solution.joint_velocity) < REST_FRACTION * limits.velocity).all())
            holding = self._holding(q, solution, row_scale) if at_rest else ""
            if holding:
                distance = f"{1e3 * np.linalg.norm(error_b[:3]):.1f} mm, {np.linalg.norm(error_b[3:]):.3f} rad"
                self.text = f"at rest {distance} off the target, held by {holding}"
                self.begin = self.seed = q.copy()

    def _search(self, pose_sd: Array, begin: Array, seed: Array) -> None:
        """A few iterations of the search."""
        found = self._solver.solve(pose_sd, seed, restarts=0)
        self.seed, self.calls = found.q, self.calls + 1
        if found.converged:
            difference = self._robot.difference(begin, found.q)
            joint = int(np.abs(difference).argmax())
            unit = "rad" if self._robot.revolute[joint] else "m"
            self.text += (
                f"; other joint positions reach it, {self._robot.joints[joint]} {difference[joint]:+.2f} {unit} from "
                "here (ik_solve prints them); lead the arm there by joint motion or targets on the way"
            )
            self.seed = None
        elif found.reason is not TerminationReason.CAP or self.calls >= CALLS_PER_START:
            self.start, self.calls = self.start + 1, 0
            if self.start < STARTS:
                self.seed = self._start(begin)
            else:
                self.text += f"; none of {STARTS} searches found joint positions within the limits that reach it"
                self.seed = None

    def _start(self, begin: Array) -> Array:
        first = STARTS - RANGE_STARTS
        if self.start >= first:
            start = self._solver.start(self.start - first)
        else:
            start = begin + SPREAD * (2.0 * low_discrepancy_points(self.start - 1, len(begin)) - 1.0)
        return np.where(self._is_locked, begin, start)

    def _holding(self, q: Array, solution: DifferentialIkSolution, row_scale: Array) -> str:
        """Limits of position and dampers that bind, and the joints of a singularity; empty for none of these."""
        names = [name for name in solution.binding if name.startswith(("position", "damper"))]
        if np.abs(solution.truncated_b).max() > 1e-6 or solution.singularity_scale < 0.99:
            _, _, vt = np.linalg.svd(row_scale[:, None] * self._robot.evaluate(q).jacobian_b)
            weak = vt[min(6, self._robot.n) - 1]
            joints = (joint for joint, part in zip(self._robot.joints, weak, strict=True) if abs(part) > PARTICIPATION)
            names.append(f"a singularity of {', '.join(joints)}")
        return " and ".join(names)


@compiled
def _error_and_motion(error_b: Array, row_scale: Array, twist_d: Array) -> tuple[float, bool]:
    """Norm of the error of the pose, m, and whether the reference moves."""
    square, linear, angular = 0.0, 0.0, 0.0
    for i in range(6):
        square += (row_scale[i] * error_b[i]) ** 2
    for i in range(3):
        linear += twist_d[i] ** 2
        angular += twist_d[3 + i] ** 2
    return np.sqrt(square), linear > REFERENCE_M_S**2 or angular > REFERENCE_RAD_S**2

"""Feedback laws: desired body twist or joint velocity from measured and desired pose (lecture notes, section 3)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.motion import Motion
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.quaternion import length
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ControlSettings


class DesiredTwist(NamedTuple):
    """Output of the task-space feedback law; twists (6,) in {b}, linear part first."""

    error_b: Array
    """log(T_bd), m and rad."""
    feedforward_b: Array
    """Ad(T_bd) V_d, m/s and rad/s."""
    twist_b: Array
    """V = feed-forward plus feedback, m/s and rad/s."""


class IkDifferenceSnapshot(NamedTuple):
    """Attributes of an :class:`IkDifference`."""

    solution: Array | None
    converged: bool


class IkDifference:
    """Joint-space feedback qd = g (theta_d - theta), with theta_d the inverse kinematics of the next desired pose.

    With g = 1 / dt this is the first law of the lecture notes, (theta_d(k dt) - theta((k-1) dt)) / dt. Its loop gain
    1 / dt is unstable for an arm with lag, so g is a setting. For continuous joints the difference is the smallest
    rotation, because a jump of 2 pi in theta_d would give an excessive velocity.
    """

    def __init__(self, robot: Robot, tolerance: TaskTolerance, locked: tuple[str, ...] = ()) -> None:
        self._robot = robot
        self.configure(tolerance, locked)
        self.solution: Array | None = None
        """Last theta_d, the initial value of the next one; None: start from the measured position."""
        self.converged = True
        """False when no solution near the last one was found; the best approximation is used."""

    def configure(self, tolerance: TaskTolerance, locked: tuple[str, ...] = ()) -> None:
        """Applies another tolerance and locked joints; the next solution starts from the measured position."""
        self._is_locked = np.isin(self._robot.joints, locked)
        self._solver = PoseSolver(
            self._robot,
            eps_omega=1e-9,
            eps_v=1e-9,
            search_iterations=20,
            max_iterations=20,
            tolerance=tolerance,
            compared_searches=1,
            locked=locked,
        )
        self.solution = None

    def velocity(self, q: Array, motion: Motion, hold_s: float, gain: float) -> Array:
        """Computes the joint velocity for the desired pose at the end of the control interval.

        Args:
            q: Measured joint positions, (n,), rad (m).
            motion: Desired motion.
            hold_s: Length of the control interval, s.
            gain: g, 1/s.

        Returns:
            qd, (n,), rad/s (m/s).
        """
        pose_next = motion.pose_sd @ se3.exp(hold_s * motion.twist_d)
        seed = q if self.solution is None else np.where(self._is_locked, q, self.solution)
        result = self._solver.solve(pose_next, seed, restarts=0)
        self.solution, self.converged = result.q, result.converged
        return gain * self._robot.difference(q, result.q)


def twist_feedback(pose_sb: Array, motion: Motion, control: ControlSettings) -> DesiredTwist:
    """Computes V = Ad(T_bd) V_d + K_p log(T_bd), with T_bd = T_sb^-1 T_sd.

    The lecture notes, section 3, use V_d without the adjoint; but V_d is expressed in {d}, and the body Jacobian maps
    to {b}. The speed of the feedback term is bounded and its direction kept, so a distant target is approached at this
    speed.

    Args:
        pose_sb: Measured pose of the tool, (4, 4).
        motion: Desired pose and twist.
        control: Gains and bounds.

    Returns:
        Pose error and twists.
    """
    return _feedback(
        np.ascontiguousarray(pose_sb),
        *motion,
        *control.gain,
        *control.max_feedback_twist,
    )


@compiled
def _feedback(
    pose_sb: Array,
    pose_sd: Array,
    twist_d: Array,
    gain_linear: float,
    gain_angular: float,
    max_linear: float,
    max_angular: float,
) -> DesiredTwist:
    pose_bd = se3.relative_pose(pose_sb, pose_sd)
    error_b, feedforward_b = se3.log6(pose_bd), se3.transform_twist(pose_bd, twist_d)
    twist_b = feedforward_b.copy()
    for first, gain, limit in ((0, gain_linear, max_linear), (3, gain_angular, max_angular)):
        x, y, z = gain * error_b[first], gain * error_b[first + 1], gain * error_b[first + 2]
        speed = length((x, y, z))
        ratio = limit / speed if speed > limit else 1.0
        twist_b[first] += ratio * x
        twist_b[first + 1] += ratio * y
        twist_b[first + 2] += ratio * z
    return DesiredTwist(error_b, feedforward_b, twist_b)

"""From where the tool is and should be to the body twist it should have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.interfaces.motion import Motion
from ik_node.inverse_kinematics.pose_solver import PoseSolver
from ik_node.jit import compiled
from ik_node.math import se3
from ik_node.math.quaternion import length
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ControlSettings


class DesiredTwist(NamedTuple):
    """What a control law asks for; twists (6,) in {b}, linear part first."""

    error_b: Array
    """log(T_bd), m and rad."""
    feedforward_b: Array
    """Ad(T_bd) V_d."""
    twist_b: Array
    """V: feed-forward plus feedback."""


class IkDifferenceSnapshot(NamedTuple):
    """What :class:`IkDifference` remembers."""

    solution: Array | None
    converged: bool


class IkDifference:
    """qd = g (theta_d - theta): the joints of inverse kinematics at the next tick, less the measured ones.

    At g = 1 / dt this is the lecture notes' first law, theta_d(k dt) - theta((k-1) dt) over dt. Its loop gain is then
    1 / dt, more than an arm that answers late can bear, so g is a setting. The difference is taken the short way round
    where a joint has no limits (a jump of 2 pi in the solution would else be a huge velocity).
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._solver = PoseSolver(robot, eps_omega=1e-9, eps_v=1e-9, search_iterations=20, max_iterations=20)
        self.solution: Array | None = None
        """The last theta_d, the seed of the next one; None starts from the measured position."""
        self.converged = True
        """False while the desired pose has no solution near the last one; the nearest is taken."""

    def velocity(self, q: Array, motion: Motion, hold_s: float, gain: float) -> Array:
        """qd (n,), rad/s (m/s), at measured ``q``, for the pose that ``motion`` reaches after ``hold_s``."""
        pose_next = motion.pose_sd @ se3.exp(hold_s * motion.twist_d)
        seed = q if self.solution is None else self.solution
        answer = self._solver.solve(pose_next, seed, restarts=0)
        self.solution, self.converged = answer.q, answer.converged
        return gain * self._robot.difference(q, answer.q)


def twist_feedback(pose_sb: Array, motion: Motion, control: ControlSettings) -> DesiredTwist:
    """V = Ad(T_bd) V_d + K_p log(T_bd), with T_bd = T_sb^-1 T_sd.

    The lecture notes, section 3, use V_d as it is; it lives in {d} while the body Jacobian maps to {b}, so the adjoint
    stands between them. The feedback part is capped in speed, its direction kept: a far target is approached at bounded
    speed.
    """
    return _feedback(
        np.ascontiguousarray(pose_sb),
        *motion,
        control.gain_linear,
        control.gain_angular,
        control.max_feedback_linear,
        control.max_feedback_angular,
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
    pose_bd = se3.between(pose_sb, pose_sd)
    error_b, feedforward_b = se3.twist_to(pose_bd), se3.carried(pose_bd, twist_d)
    twist_b = feedforward_b.copy()
    for first, gain, limit in ((0, gain_linear, max_linear), (3, gain_angular, max_angular)):
        x, y, z = gain * error_b[first], gain * error_b[first + 1], gain * error_b[first + 2]
        speed = length((x, y, z))
        part = limit / speed if speed > limit else 1.0
        twist_b[first] += part * x
        twist_b[first + 1] += part * y
        twist_b[first + 2] += part * z
    return DesiredTwist(error_b, feedforward_b, twist_b)

"""From where the tool is and should be to the body twist it should have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node import se3
from ik_node.inverse_kinematics import PoseSolver
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import ControlSettings
from ik_node.trajectory.motion import Motion


class DesiredTwist(NamedTuple):
    """What a control law asks for; twists (6,) in {b}, linear part first."""

    error_b: Array
    """log(T_bd), m and rad."""
    feedforward_b: Array
    """Ad(T_bd) V_d."""
    twist_b: Array
    """V: feed-forward plus feedback."""


class IkMemory(NamedTuple):
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
    pose_bd = se3.inverse(pose_sb) @ motion.pose_sd
    error_b = se3.log(pose_bd)
    feedforward_b = se3.adjoint(pose_bd) @ motion.twist_d
    feedback = np.empty(6)
    feedback[:3] = _capped(control.gain_linear * error_b[:3], control.max_feedback_linear)
    feedback[3:] = _capped(control.gain_angular * error_b[3:], control.max_feedback_angular)
    return DesiredTwist(error_b, feedforward_b, feedforward_b + feedback)


def _capped(velocity: Array, limit: float) -> Array:
    speed = float(np.sqrt(velocity @ velocity))
    return velocity * (limit / speed) if speed > limit else velocity

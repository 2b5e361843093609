"""From where the tool is and should be to the body twist it should have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node import se3
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

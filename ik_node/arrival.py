"""Feedback that the joints can brake: an error is closed no faster than the arm can stop at its end.

K_p times a large error asks for a speed that has to be taken off again by joint accelerations of K_p times the joint
speed: at 10 1/s and 2 rad/s twice what most arms can do. The box of joint velocities then cuts in, and the tool
overshoots its target, off its path. Linearised, the error is a joint displacement

    dq = J^+ log(T_bd)

and every joint can stop within its part of it if its speed is at most vbar(|dq_j|) of :mod:`ik_node.limits`. The
feedback is scaled as a whole, so that its direction is kept; small errors are not touched, since vbar(d) / d rises to
1 / dt_max, far above K_p.
"""

from __future__ import annotations

import numpy as np

from ik_node.limits import MotionLimits, viable_speed
from ik_node.resolution import smooth_fade
from ik_node.se3 import Array

BRAKING_PART = 0.7
"""Part of the joint accelerations that braking counts on; the feed-forward needs some too."""


def arriving(
    jacobian: Array, error: Array, feedback: Array, limits: MotionLimits, row_scale: Array, threshold: float
) -> Array:
    """``feedback`` (m,), or as much of it as the joints can brake before the ``error`` (m,) is closed.

    ``jacobian`` J (m, n), ``error`` and ``feedback`` in one frame, the feedback along the error or part by part along
    its halves. ``row_scale`` (m,) and ``threshold``: singular values below it, of J with rows scaled, fade out, since
    an error in a lost direction does not tell how far the joints have to go.
    """
    if not error.any():
        return feedback
    u, sigma, rows = np.linalg.svd(row_scale[:, None] * jacobian, full_matrices=False)
    faded = smooth_fade(sigma / threshold) / np.maximum(sigma, 1e-12)
    inverse = (faded * (u.T @ (row_scale * error))) @ rows
    speed = np.abs((faded * (u.T @ (row_scale * feedback))) @ rows)
    allowed = viable_speed(np.abs(inverse), BRAKING_PART * limits.acceleration, limits.dt_max_s)
    return feedback * min(1.0, float(np.min(allowed / np.maximum(speed, 1e-12))))

"""Differences of joint positions; the angle of a continuous joint is taken modulo one turn."""

from __future__ import annotations

from math import pi

import numpy as np

from ik_node.jit import compiled, elementwise


@compiled
def joint_difference(q_from: float, q_to: float, continuous: bool) -> float:
    """``q_to - q_from``; for a ``continuous`` joint (no position limits) brought into -pi..pi."""
    delta = q_to - q_from
    return delta - 2.0 * pi * np.round(delta / (2.0 * pi)) if continuous else delta


joint_differences = elementwise(joint_difference)
"""The same for arrays, with broadcasting."""

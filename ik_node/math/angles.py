"""The short way from one joint position to another."""

from __future__ import annotations

from math import pi

import numpy as np

from ik_node.jit import compiled, elementwise


@compiled
def short_way(q_from: float, q_to: float, continuous: bool) -> float:
    """``q_to - q_from``, without whole turns where the joint is ``continuous``: it has no limits."""
    delta = q_to - q_from
    return delta - 2.0 * pi * np.round(delta / (2.0 * pi)) if continuous else delta


short_ways = elementwise(short_way)
"""The same of arrays."""

"""Gains with which the tracking filter follows the prediction of a target, by the sample period."""

from __future__ import annotations

from ik_node.jit import compiled
from ik_node.settings.groups import Pair

GAIN, BANDWIDTH = 1.0, 6.5
"""Gains of the cascade for error and velocity [1/s] times the sample period [s]. The prediction changes at each sample:
its velocity is followed at once, its position slowly, which is smoother than a triple pole with the same error."""
MAX_GAIN: Pair = (15.0, 28.0)
MAX_BANDWIDTH: Pair = (130.0, 100.0)
"""Largest gains [1/s] of position and orientation, for fast streams."""


@compiled
def cascade_gains(period_s: float, half: int) -> tuple[float, float]:
    """Gains of the cascade for error and velocity [1/s].

    Args:
        period_s: Sample period.
        half: 0 for the position, 1 for the orientation.
    """
    return min(GAIN / period_s, MAX_GAIN[half]), min(BANDWIDTH / period_s, MAX_BANDWIDTH[half])

"""Timers that run whatever happens to ROS time.

With ``use_sim_time`` a timer of a node stands still while /clock is silent, paused or behind: zeros and signals would
wait for a simulator that has died.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType


def create_steady_timer(node: Any, period_s: float, callback: Callable[[], None]) -> Any:
    """Create a timer of ``node`` on the steady clock, for all timers of this package.

    Args:
        node: The node whose executor calls ``callback``.
        period_s: Period, s, by the monotonic clock of the machine.
        callback: Takes no arguments.

    Returns:
        The timer, which the node keeps.
    """
    return node.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))

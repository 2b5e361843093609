"""Time as an argument: below ``ros/`` and ``cli/`` nothing looks at a clock, so that a replay gives the run's bits.

All reasoning happens in monotonic nanoseconds. ROS stamps are only used to learn how old a message is.
"""

from __future__ import annotations

from typing import NamedTuple

NS = 1_000_000_000
"""Nanoseconds in a second."""


class Instant(NamedTuple):
    """One moment as two clocks show it."""

    monotonic_ns: int
    """Steady clock: durations and time-outs."""
    ros_ns: int
    """ROS time (system or simulated): what message stamps are compared with."""


class Stamped(NamedTuple):
    """When a message's content holds, on the monotonic clock."""

    time_ns: int
    """Monotonic time at which the content held."""
    received_ns: int
    """Monotonic time at which it arrived."""
    skew_ns: int
    """0, or the age in ROS time that was not believable, so that ``time_ns`` is the arrival."""


def place(stamp_ns: int, now: Instant, max_age_ns: int, max_ahead_ns: int = 0) -> Stamped:
    """Places a header stamp on the monotonic clock.

    A stamp of 0 means "now". A stamp older than ``max_age_ns`` or more than ``max_ahead_ns`` in the future is another
    machine's clock: arrival counts instead, and the difference is handed back as ``skew_ns`` to be reported.
    """
    if stamp_ns == 0:
        return Stamped(now.monotonic_ns, now.monotonic_ns, 0)
    age_ns = now.ros_ns - stamp_ns
    if -max_ahead_ns <= age_ns <= max_age_ns:
        return Stamped(now.monotonic_ns - age_ns, now.monotonic_ns, 0)
    return Stamped(now.monotonic_ns, now.monotonic_ns, age_ns)

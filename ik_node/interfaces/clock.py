"""Times as arguments: below ``ros`` and ``cli`` no module reads a clock, so a replay reproduces a run bit for bit.

Internal times are monotonic nanoseconds. ROS stamps only determine the age of a message.
"""

from __future__ import annotations

from typing import NamedTuple

NS = 1_000_000_000
"""Nanoseconds in a second."""


class Instant(NamedTuple):
    """One instant on two clocks."""

    monotonic_ns: int
    """Monotonic clock, for durations and time-outs."""
    ros_ns: int
    """ROS time (system or simulated), which message stamps are compared with."""


class Stamped(NamedTuple):
    """Time of the content of a message, on the monotonic clock."""

    time_ns: int
    """Monotonic time at which the content was valid."""
    received_ns: int
    """Monotonic time of arrival."""
    skew_ns: int
    """0, or the implausible age in ROS time; ``time_ns`` is then the time of arrival."""


def to_monotonic(stamp_ns: int, now: Instant, max_age_ns: int, max_ahead_ns: int = 0) -> Stamped:
    """Converts a header stamp to the monotonic clock.

    Args:
        stamp_ns: Header stamp in ROS time; 0 means "now".
        now: Time of arrival.
        max_age_ns: Largest plausible age. An older stamp is from another clock, and the time of arrival is used.
        max_ahead_ns: Largest plausible time in the future; likewise.

    Returns:
        The times; ``skew_ns`` is the age of a stamp that was not plausible.
    """
    if stamp_ns == 0:
        return Stamped(now.monotonic_ns, now.monotonic_ns, 0)
    age_ns = now.ros_ns - stamp_ns
    if -max_ahead_ns <= age_ns <= max_age_ns:
        return Stamped(now.monotonic_ns - age_ns, now.monotonic_ns, 0)
    return Stamped(now.monotonic_ns, now.monotonic_ns, age_ns)

"""Detects a robot that does not follow its commands: protective stop, inactive controller, reduced speed (slider).

The commanded motion is compared with the measured one over a short and a long window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.angles import joint_difference
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.follow import FollowSettings

MIN_MOTION = 0.03
"""Commanded motion [rad or m] of a joint below which following is not evaluated."""
WINDOW_S = 0.25
"""Length of the short window."""
RETRY_S = 1.0
"""Time after which a robot that did not follow is tried again."""
LONG_WINDOWS = 8
"""Length of the long window, in short windows; it detects slow motions."""
STANDSTILL_RATIO = 0.1
"""Ratio of measured to commanded motion below which the robot counts as standing still."""

SELF_MOTION = 0.1
"""Measured motion [rad or m] of a joint while none is commanded from which the robot moves by itself: more than the
remaining motion of an arm with a lag of 50 ms at 2 rad/s."""

FOLLOWS, STANDS, LAGS, BY_ITSELF = 0, 1, 2, 3
MESSAGES = (
    "",
    "the robot does not move: protective stop, or its controller is not active",
    "the robot moves less than commanded: speed slider, or a limit in the robot",
    "the robot moves by itself: another controller or a person moves it, or joints have another order or sign",
)
"""Status texts for these values."""


class FollowingErrorSnapshot(NamedTuple):
    """The last k measurements of a :class:`FollowingErrorMonitor`."""

    times_ns: NDArray[np.int64]
    """Monotonic times, (k,)."""
    positions: Array
    """Measured positions, (k, n), rad (m)."""
    commanded: Array
    """Integral of the commands up to each measurement, (k, n), rad (m)."""
    sums: Array
    """(k, 2), rad2 (m2): sums over the intervals between measurements of commanded' measured motion, and of commanded'
    commanded motion."""


class FollowingErrorMonitor:
    """Compares commanded and measured joint motion over a short and a long window."""

    def __init__(self, robot: Robot, settings: FollowSettings) -> None:
        self._robot = robot
        self._rows = _empty_rows(256, robot.n)
        """Ring buffer; the oldest measurement is in row ``first``."""
        self._first = self._count = 0
        self.configure(settings)

    def configure(self, settings: FollowSettings) -> None:
        """Applies changed settings."""
        self._settings = settings
        self._window_ns = round(WINDOW_S * NS)

    def capture(self) -> FollowingErrorSnapshot:
        """Snapshot for :meth:`restore`."""
        rows = self._rows
        kept = (self._first + np.arange(self._count)) % len(rows.times_ns)
        return FollowingErrorSnapshot(rows.times_ns[kept], rows.positions[kept], rows.commanded[kept], rows.sums[kept])

    def restore(self, snapshot: FollowingErrorSnapshot) -> None:
        """Continues, bit for bit, from a snapshot."""
        self._first, self._count = 0, len(snapshot.times_ns)
        self._rows = _empty_rows(max(2 * self._count, 256), self._robot.n)
        for column, values in zip(self._rows, snapshot, strict=True):
            column[: self._count] = values.reshape(self._count, *column.shape[1:])

    def reset(self) -> None:
        """Discards all measurements."""
        self._first = self._count = 0

    def update(self, time_ns: int, position: Array, command: Array) -> str:
        """Adds a measurement and evaluates both windows.

        Args:
            time_ns: Monotonic time of the measurement.
            position: Measured joint positions, (n,), rad (m).
            command: Command since the last measurement, (n,), rad/s (m/s).

        Returns:
            Why the robot does not follow, as text that names the joint with the largest deviation; empty while it
            follows or the commanded motion is too small.
        """
        if self._count == len(self._rows.times_ns):
            self.restore(self.capture())
        self._first, self._count, status, begin = _updated(
            *self._rows,
            self._first,
            self._count,
            time_ns,
            position,
            command,
            self._robot.continuous,
            self._window_ns,
            MIN_MOTION,
            self._settings.min_ratio,
        )
        return f"{MESSAGES[status]}; largest deviation at joint '{self._deviating(begin)}'" if status else ""

    def _deviating(self, begin: int) -> str:
        """Name of the joint whose commanded and measured motion since the measurement in row ``begin`` differ most."""
        rows, end = self._rows, (self._first + self._count - 1) % len(self._rows.times_ns)
        commanded = rows.commanded[end] - rows.commanded[begin]
        deviation = [
            abs(distance - joint_difference(*way))
            for distance, *way in zip(
                commanded, rows.positions[begin], rows.positions[end], self._robot.continuous, strict=True
            )
        ]
        return self._robot.joints[int(np.argmax(deviation))]


def _empty_rows(count: int, n: int) -> FollowingErrorSnapshot:
    return FollowingErrorSnapshot(
        np.empty(count, dtype=np.int64), np.empty((count, n)), np.empty((count, n)), np.empty((count, 2))
    )


@compiled
def _updated(
    times_ns: NDArray[np.int64],
    positions: Array,
    commanded: Array,
    sums: Array,
    first: int,
    count: int,
    time_ns: int,
    position: Array,
    command: Array,
    continuous: NDArray[np.bool_],
    window_ns: int,
    min_motion: float,
    min_ratio: float,
) -> tuple[int, int, int, int]:
    """Appends a row to the ring buffer.

    Returns:
        The new first row, the new number of rows, the status, and the first row of the window that it describes.
    """
    rows, n = len(times_ns), len(position)
    last, now = (first + count - 1) % rows, (first + count) % rows
    times_ns[now], positions[now], commanded[now], sums[now] = time_ns, position, 0.0, 0.0
    if count == 0:
        return first, 1, FOLLOWS, first
    elapsed_s = (time_ns - times_ns[last]) / NS
    followed, squared = 0.0, 0.0
    for i in range(n):
        step = command[i] * elapsed_s
        commanded[now, i] = commanded[last, i] + step
        followed += step * joint_difference(positions[last, i], position[i], continuous[i])
        squared += step * step
    sums[now, 0], sums[now, 1] = sums[last, 0] + followed, sums[last, 1] + squared
    count += 1
    while count > 2 and times_ns[(first + 1) % rows] <= time_ns - LONG_WINDOWS * window_ns:
        first, count = (first + 1) % rows, count - 1
    span_ns = time_ns - times_ns[first]
    if span_ns < window_ns:
        return first, count, FOLLOWS, first
    # Measurements are almost evenly spaced: the row one window ago is found by proportion, without a search.
    ago = round(window_ns / span_ns * (count - 1))
    recent = (first + max(count - 1 - ago, 0)) % rows
    begin = recent
    status = _status(positions, commanded, sums, begin, now, continuous, min_motion, min_ratio)
    if status == FOLLOWS:
        begin = first
        status = _status(positions, commanded, sums, begin, now, continuous, min_motion, min_ratio)
    return first, count, status, begin


@compiled
def _status(
    positions: Array,
    commanded: Array,
    sums: Array,
    begin: int,
    end: int,
    continuous: NDArray[np.bool_],
    min_motion: float,
    min_ratio: float,
) -> int:
    """Status of the motion from the measurement in row ``begin`` to that in row ``end``."""
    evaluated, moved, along, squared = False, False, 0.0, 0.0
    for i in range(commanded.shape[1]):
        distance = commanded[end, i] - commanded[begin, i]
        evaluated = evaluated or not abs(distance) < min_motion
        measured = joint_difference(positions[begin, i], positions[end, i], continuous[i])
        moved = moved or abs(measured) > SELF_MOTION
        along += distance * measured
        squared += distance * distance
    if not evaluated:
        return BY_ITSELF if moved and sums[end, 1] - sums[begin, 1] < min_motion * min_motion * 1e-3 else FOLLOWS
    # With a delay of 20 ms, the end point of a motion that reverses differs from the commanded one, and fast
    # oscillations do not agree step by step. The robot does not follow when both measures are too small.
    steps = (sums[end, 0] - sums[begin, 0]) / (sums[end, 1] - sums[begin, 1])
    ratio = max(steps, along / squared)
    if ratio >= min_ratio:
        return FOLLOWS
    if ratio < -STANDSTILL_RATIO:
        return BY_ITSELF
    return STANDS if ratio < STANDSTILL_RATIO else LAGS

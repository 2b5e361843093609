"""Does the robot do what it is told? A protective stop, a speed slider or a controller that is not active say no."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.interfaces.clock import NS
from ik_node.jit import compiled
from ik_node.math.angles import short_way
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import FollowSettings

LONG_WINDOWS = 8
"""Slow motions are judged over this many windows."""
STANDSTILL = 0.1
"""A robot that does less than this part of what it is told counts as standing."""


FOLLOWS, STANDS, LAGS = 0, 1, 2
WORDS = (
    "",
    "the robot does not move: protective stop, or its controller is not active",
    "the robot moves less than it is told: speed slider, or a limit of its own",
)
"""Of these verdicts."""


class FollowingErrorSnapshot(NamedTuple):
    """What a :class:`FollowMonitor` remembers: the arm at the last k measurements."""

    times_ns: NDArray[np.int64]
    """(k,)."""
    positions: Array
    """(k, n), measured, rad (m)."""
    told: Array
    """(k, n), the sum of all commands up to then, rad (m): where it would be if it had followed, but for a constant."""
    sums: Array
    """(k, 2): agreed, the sum of told' went over the steps from measurement to measurement, rad2 (m2); and asked, the
    sum of told' told over the same steps."""


class FollowMonitor:
    """Compares how the joints were told to go with how they went, over a short and a long window."""

    def __init__(self, robot: Robot, settings: FollowSettings) -> None:
        self._robot = robot
        self._rows = _empty_rows(256, robot.n)
        """A ring: the oldest measurement is in row ``first``."""
        self._first = self._count = 0
        self.configure(settings)

    def configure(self, settings: FollowSettings) -> None:
        """Other settings from now on."""
        self._settings = settings
        self._window_ns = round(settings.window_s * NS)

    def capture(self) -> FollowingErrorSnapshot:
        """For :meth:`restore`."""
        rows = self._rows
        kept = (self._first + np.arange(self._count)) % len(rows.times_ns)
        return FollowingErrorSnapshot(rows.times_ns[kept], rows.positions[kept], rows.told[kept], rows.sums[kept])

    def restore(self, snapshot: FollowingErrorSnapshot) -> None:
        """Goes on, bit for bit, from ``snapshot``."""
        self._first, self._count = 0, len(snapshot.times_ns)
        self._rows = _empty_rows(max(2 * self._count, 256), self._robot.n)
        for column, values in zip(self._rows, snapshot, strict=True):
            column[: self._count] = values.reshape(self._count, *column.shape[1:])

    def forget(self) -> None:
        """The arm begins anew: what was told before does not count."""
        self._first = self._count = 0

    def observe(self, time_ns: int, position: Array, command: Array) -> str:
        """Takes a measurement (n,) and the command (n,) that has stood since the last one.

        Returns why the robot does not follow; empty while it does, or while too little was asked of it to tell.
        """
        if self._count == len(self._rows.times_ns):
            self.restore(self.capture())
        self._first, self._count, verdict = _observed(
            *self._rows,
            self._first,
            self._count,
            time_ns,
            position,
            command,
            self._robot.continuous,
            self._window_ns,
            self._settings.least_motion,
            self._settings.part,
        )
        return WORDS[verdict]


def _empty_rows(count: int, n: int) -> FollowingErrorSnapshot:
    return FollowingErrorSnapshot(
        np.empty(count, dtype=np.int64), np.empty((count, n)), np.empty((count, n)), np.empty((count, 2))
    )


@compiled
def _observed(
    times_ns: NDArray[np.int64],
    positions: Array,
    told: Array,
    sums: Array,
    first: int,
    count: int,
    time_ns: int,
    position: Array,
    command: Array,
    continuous: NDArray[np.bool_],
    window_ns: int,
    least_motion: float,
    least_part: float,
) -> tuple[int, int, int]:
    """Writes one more row into the ring; gives the first row and the count from now on, and the verdict."""
    rows, n = len(times_ns), len(position)
    last, now = (first + count - 1) % rows, (first + count) % rows
    times_ns[now], positions[now], told[now], sums[now] = time_ns, position, 0.0, 0.0
    if count == 0:
        return first, 1, FOLLOWS
    elapsed_s = (time_ns - times_ns[last]) / NS
    agreed, asked = 0.0, 0.0
    for i in range(n):
        step = command[i] * elapsed_s
        told[now, i] = told[last, i] + step
        agreed += step * short_way(positions[last, i], position[i], continuous[i])
        asked += step * step
    sums[now, 0], sums[now, 1] = sums[last, 0] + agreed, sums[last, 1] + asked
    count += 1
    while count > 2 and times_ns[(first + 1) % rows] <= time_ns - LONG_WINDOWS * window_ns:
        first, count = (first + 1) % rows, count - 1
    span_ns = time_ns - times_ns[first]
    if span_ns < window_ns:
        return first, count, FOLLOWS
    # Entries come at nearly even times: the one a window ago is found by proportion, not by searching.
    ago = round(window_ns / span_ns * (count - 1))
    recent = (first + max(count - 1 - ago, 0)) % rows
    verdict = _verdict(positions, told, sums, recent, now, continuous, least_motion, least_part)
    if verdict == FOLLOWS:
        verdict = _verdict(positions, told, sums, first, now, continuous, least_motion, least_part)
    return first, count, verdict


@compiled
def _verdict(
    positions: Array,
    told: Array,
    sums: Array,
    begin: int,
    end: int,
    continuous: NDArray[np.bool_],
    least_motion: float,
    least_part: float,
) -> int:
    """From the measurement in one row to that in another."""
    judged, along, squared = False, 0.0, 0.0
    for i in range(told.shape[1]):
        way = told[end, i] - told[begin, i]
        judged = judged or not abs(way) < least_motion
        along += way * short_way(positions[begin, i], positions[end, i], continuous[i])
        squared += way * way
    if not judged:
        return FOLLOWS
    # An arm that is late by 20 ms ends a motion that turned round somewhere else than it was told, and does not do
    # every tremble step by step; who does neither does not follow.
    steps = (sums[end, 0] - sums[begin, 0]) / (sums[end, 1] - sums[begin, 1])
    part = max(steps, along / squared)
    if part >= least_part:
        return FOLLOWS
    return STANDS if part < STANDSTILL else LAGS

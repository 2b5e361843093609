"""Does the robot do what it is told? A protective stop, a speed slider or a controller that is not active say no."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.clock import NS
from ik_node.robot import Robot
from ik_node.se3 import Array
from ik_node.settings import FollowSettings

LONG_WINDOWS = 8
"""Slow motions are judged over this many windows."""
STANDSTILL = 0.1
"""A robot that does less than this part of what it is told counts as standing."""


class Moment(NamedTuple):
    """The arm at one measurement."""

    time_ns: int
    position: Array
    """Measured, (n,), rad (m)."""
    told: Array
    """The sum of all commands up to now, (n,), rad (m): where it would be if it had followed, but for a constant."""
    agreed: float
    """The sum of told' went over the steps from measurement to measurement, rad2 (m2)."""
    asked: float
    """The sum of told' told over the same steps."""


class FollowMemory(NamedTuple):
    """What a :class:`FollowMonitor` remembers."""

    times_ns: NDArray[np.int64]
    """(k,), of its moments."""
    positions: Array
    """(k, n)."""
    told: Array
    """(k, n)."""
    sums: Array
    """(k, 2): agreed and asked."""


class FollowMonitor:
    """Compares how the joints were told to go with how they went, over a short and a long window."""

    def __init__(self, robot: Robot, settings: FollowSettings) -> None:
        self._robot = robot
        self._moments: deque[Moment] = deque()
        self.configure(settings)

    def configure(self, settings: FollowSettings) -> None:
        """Other settings from now on."""
        self._settings = settings
        self._window_ns = round(settings.window_s * NS)

    def memory(self) -> FollowMemory:
        """For :meth:`recall`."""
        rows, nothing = self._moments, np.zeros(0)
        return FollowMemory(
            np.array([row.time_ns for row in rows], dtype=np.int64),
            np.concatenate([nothing, *(row.position for row in rows)]).reshape(-1, self._robot.n),
            np.concatenate([nothing, *(row.told for row in rows)]).reshape(-1, self._robot.n),
            np.array([(row.agreed, row.asked) for row in rows]).reshape(-1, 2),
        )

    def recall(self, memory: FollowMemory) -> None:
        """Goes on, bit for bit, from ``memory``."""
        rows = zip(memory.times_ns.tolist(), memory.positions.copy(), memory.told.copy(), strict=True)
        self._moments = deque(Moment(*row, *sums) for row, sums in zip(rows, memory.sums.tolist(), strict=True))

    def forget(self) -> None:
        """The arm begins anew: what was told before does not count."""
        self._moments.clear()

    def observe(self, time_ns: int, position: Array, command: Array) -> str:
        """Takes a measurement (n,) and the command (n,) that has stood since the last one.

        Returns why the robot does not follow; empty while it does, or while too little was asked of it to tell.
        """
        if not self._moments:
            self._moments.append(Moment(time_ns, position, np.zeros(len(position)), 0.0, 0.0))
            return ""
        last = self._moments[-1]
        step = command * ((time_ns - last.time_ns) / NS)
        went = self._robot.difference(last.position, position)
        agreed, asked = last.agreed + float(step @ went), last.asked + float(step @ step)
        now = Moment(time_ns, position, last.told + step, agreed, asked)
        self._moments.append(now)
        while len(self._moments) > 2 and self._moments[1].time_ns <= time_ns - LONG_WINDOWS * self._window_ns:
            self._moments.popleft()
        oldest = self._moments[0]
        if time_ns - oldest.time_ns < self._window_ns:
            return ""
        # Entries come at nearly even times: the one a window ago is found by proportion, not by searching.
        part = self._window_ns / (time_ns - oldest.time_ns)
        recent = self._moments[max(len(self._moments) - 1 - round(part * (len(self._moments) - 1)), 0)]
        return self._judge(recent, now) or self._judge(oldest, now)

    def _judge(self, begin: Moment, end: Moment) -> str:
        told = end.told - begin.told
        if np.abs(told).max() < self._settings.least_motion:
            return ""
        # An arm that is late by 20 ms ends a motion that turned round somewhere else than it was told, and does not do
        # every tremble step by step; who does neither does not follow.
        steps = (end.agreed - begin.agreed) / (end.asked - begin.asked)
        went = self._robot.difference(begin.position, end.position)
        part = max(steps, float(told @ went) / float(told @ told))
        if part >= self._settings.part:
            return ""
        if part < STANDSTILL:
            return "the robot does not move: protective stop, or its controller is not active"
        return "the robot moves less than it is told: speed slider, or a limit of its own"

"""A time law: how far along a path one is at each time, from rest to rest, with continuous acceleration."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from ik_node.se3 import Array


class LawTable(NamedTuple):
    """Times at which points of a path are passed before they are smoothed; plain data."""

    times_s: Array
    """(M,), increasing from 0."""
    places: Array
    """(M,), increasing: the path's parameter."""
    rates: Array
    """(M,), its derivative: 0 at both ends, and linear in time in between."""
    window_s: float
    """Everything is the mean over so much time: that makes acceleration continuous, and jerk bounded."""


class TimeLaw:
    """A :class:`LawTable` as a function; immutable."""

    def __init__(self, table: LawTable) -> None:
        steps = np.diff(table.times_s)
        changes = np.diff(table.rates) / steps
        areas = steps * (table.places[:-1] + steps * (0.5 * table.rates[:-1] + steps * changes / 6.0))
        self._times: list[float] = table.times_s.tolist()
        self._places: list[float] = table.places.tolist()
        self._rates: list[float] = table.rates.tolist()
        self._changes: list[float] = [*changes.tolist(), 0.0]
        self._areas: list[float] = [0.0, *np.cumsum(areas).tolist()]
        self._window_s = table.window_s

    @property
    def duration_s(self) -> float:
        """From rest to rest."""
        return self._times[-1] + self._window_s

    def place(self, time_s: float) -> float:
        """The path's parameter; held at its ends outside 0 .. ``duration_s``."""
        if time_s <= 0.0:
            return self._places[0]
        if time_s >= self.duration_s:
            return self._places[-1]
        return (self._unsmoothed(time_s)[0] - self._unsmoothed(time_s - self._window_s)[0]) / self._window_s

    def rates(self, time_s: float) -> tuple[float, float]:
        """Its first and second derivative."""
        _, place, rate = self._unsmoothed(time_s)
        _, place_before, rate_before = self._unsmoothed(time_s - self._window_s)
        return (place - place_before) / self._window_s, (rate - rate_before) / self._window_s

    def _unsmoothed(self, time_s: float) -> tuple[float, float, float]:
        """The integral, the parameter and its derivative before they are smoothed."""
        first, last = self._times[0], self._times[-1]
        if time_s <= first:
            return self._places[0] * time_s, self._places[0], 0.0
        if time_s >= last:
            return self._areas[-1] + self._places[-1] * (time_s - last), self._places[-1], 0.0
        index = bisect_right(self._times, time_s) - 1
        d, place, rate = time_s - self._times[index], self._places[index], self._rates[index]
        change = self._changes[index]
        area = self._areas[index] + d * (place + d * (0.5 * rate + d * change / 6.0))
        return area, place + d * (rate + 0.5 * d * change), rate + d * change

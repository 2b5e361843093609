"""Time scaling: the path parameter as a function of time, from rest to rest, with continuous acceleration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.jit import compiled
from ik_node.math.types import Array


class TimeScalingTable(NamedTuple):
    """Times of points of a path before averaging; plain data."""

    times_s: Array
    """(M,), increasing from 0."""
    places: Array
    """(M,), increasing: the path's parameter."""
    rates: Array
    """(M,), derivative of ``places``: 0 at both ends, piecewise linear in time."""
    window_s: float
    """Averaging time, which makes acceleration continuous and jerk bounded."""


class TimeScaling:
    """A :class:`TimeScalingTable` as a function; immutable."""

    def __init__(self, table: TimeScalingTable) -> None:
        steps = np.diff(table.times_s)
        changes = np.diff(table.rates) / steps
        areas = steps * (table.places[:-1] + steps * (0.5 * table.rates[:-1] + steps * changes / 6.0))
        self.rows = np.stack(
            (table.times_s, table.places, table.rates, np.append(changes, 0.0), np.append(0.0, np.cumsum(areas))),
            axis=1,
        )
        """(M, 5): time, parameter, its first derivative, its second derivative up to the next row, its integral."""
        self.window_s = table.window_s

    @property
    def duration_s(self) -> float:
        """Duration from rest to rest."""
        return float(self.rows[-1, 0]) + self.window_s

    def place(self, time_s: float) -> float:
        """The path parameter; constant outside 0 .. ``duration_s``."""
        return place_at(self.rows, self.window_s, time_s)

    def rates(self, time_s: float) -> tuple[float, float]:
        """First and second derivative of the path parameter."""
        _, place, rate = _unsmoothed(self.rows, time_s)
        _, place_before, rate_before = _unsmoothed(self.rows, time_s - self.window_s)
        return (place - place_before) / self.window_s, (rate - rate_before) / self.window_s


@compiled
def place_at(rows: Array, window_s: float, time_s: float) -> float:
    """:meth:`TimeScaling.place`."""
    if time_s <= 0.0:
        return float(rows[0, 1])
    if time_s >= rows[-1, 0] + window_s:
        return float(rows[-1, 1])
    return (_unsmoothed(rows, time_s)[0] - _unsmoothed(rows, time_s - window_s)[0]) / window_s


@compiled
def _unsmoothed(rows: Array, time_s: float) -> tuple[float, float, float]:
    """Integral, value and derivative of the parameter before averaging."""
    if time_s <= rows[0, 0]:
        return rows[0, 1] * time_s, rows[0, 1], 0.0
    last, place, _, _, area = rows[-1]
    if time_s >= last:
        return area + place * (time_s - last), place, 0.0
    begin, place, rate, change, area = rows[np.searchsorted(rows[:, 0], time_s, side="right") - 1]
    d = time_s - begin
    area = area + d * (place + d * (0.5 * rate + d * change / 6.0))
    return area, place + d * (rate + 0.5 * d * change), rate + d * change

"""What the viewer shows over time: the columns of a run it needs, whether recorded or still going on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ik_node.interfaces.step import Status
from ik_node.math.types import Array
from ik_node.recording.run import Run


class Moment(NamedTuple):
    """One tick. What is not known is NaN. Twists and wrenches (6,): linear part first, in {b}."""

    time_s: float
    """On the axis of the film."""
    q: Array
    """(n,), rad (m)."""
    joint_velocity: Array
    """The command, (n,), rad/s (m/s)."""
    pose_sb: Array
    """Tool, (4, 4)."""
    pose_sd: Array
    """Desired pose, (4, 4)."""
    error_b: Array
    """log(T_bd), m and rad."""
    multiplier_task: Array
    """First term of lambda."""
    multiplier_potential: Array
    """Second term of lambda."""
    closest_points: Array
    """Where the clearance is, in the base frame, (2, 3), m."""
    sigma_min: float
    """Least singular value of J_b with weighted angular rows, m."""
    scale: float
    """s."""
    clearance: float
    """m."""
    closest_pair: tuple[str, ...]
    """Whose clearance that is."""
    binding: tuple[str, ...]
    """Names of the limits that bound."""
    status: Status


class Film(NamedTuple):
    """Moments as arrays; row i of each belongs together. Fields as in :class:`Moment`, k rows each."""

    times_s: Array
    """(k,), not decreasing."""
    q: Array
    joint_velocity: Array
    pose_sb: Array
    pose_sd: Array
    error_b: Array
    multiplier_task: Array
    multiplier_potential: Array
    closest_points: Array
    sigma_min: Array
    scale: Array
    clearance: Array
    closest_pair: tuple[tuple[str, ...], ...]
    binding: tuple[tuple[str, ...], ...]
    status: tuple[Status, ...]

    @property
    def begin_s(self) -> float:
        """Time of the first moment; 0 where there is none."""
        return float(self.times_s[0]) if len(self.times_s) else 0.0

    @property
    def end_s(self) -> float:
        """Time of the last moment; 0 where there is none."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0

    def row(self, time_s: float) -> int:
        """The last row at or before ``time_s``, but at least the first."""
        return max(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, 0)

    def moment(self, row: int) -> Moment:
        """One row; IndexError where there is none."""
        columns: list[Any] = [column[row] for column in self]
        values: list[Any] = [float(value) if isinstance(value, np.float64) else value for value in columns]
        return Moment(*values)

    def part(self, first: int, last: int) -> Film:
        """Rows ``first`` to ``last``, that not included."""
        columns: list[Any] = [column[first:last] for column in self]
        return Film(*columns)

    def changes(self) -> list[int]:
        """Rows at which the status is another one than before, the first row among them."""
        status = self.status
        # Neighbours are mostly the same object, which is quicker to see than that they are equal.
        return [
            row
            for row in range(len(status))
            if row == 0 or (status[row] is not status[row - 1] and status[row] != status[row - 1])
        ]

    def position_error(self) -> Array:
        """Distance of the tool from the desired position, (k,), m."""
        result: Array = np.linalg.norm(self.error_b[:, :3], axis=1)
        return result


def film_of(run: Run) -> Film:
    """The film of a recorded run."""
    sigma_min = run.singular_values[:, -1] if run.singular_values.shape[1] else np.full(len(run.times_s), np.nan)
    return Film(
        run.times_s,
        run.q,
        run.joint_velocity,
        run.pose_sb,
        run.pose_sd,
        run.error_b,
        run.multiplier_task,
        run.multiplier_potential,
        run.closest_points,
        sigma_min,
        run.scale,
        run.clearance,
        run.closest_pair,
        run.binding,
        run.status,
    )


_Texts = tuple[tuple[str, ...], tuple[str, ...], Status]


class Reel:
    """The newest moments of something that goes on; the oldest are forgotten."""

    def __init__(self, joints: int, capacity: int) -> None:
        """Keeps at least ``capacity`` moments of an arm with ``joints`` joints, and at most twice as many."""
        self._capacity = capacity
        self._shapes = ((), (joints,), (joints,), (4, 4), (4, 4), (6,), (6,), (6,), (2, 3), (), (), ())
        self._columns = self._blank()
        self._texts: list[_Texts] = []

    def append(self, moment: Moment) -> None:
        """Adds a moment; one that is not later than the last is left out."""
        used = len(self._texts)
        if used and moment.time_s <= self._columns[0][used - 1]:
            return
        if used == 2 * self._capacity:
            used = self._forget()
        values: list[Any] = list(moment[: len(self._columns)])
        for column, value in zip(self._columns, values, strict=True):
            column[used] = value
        self._texts.append((moment.closest_pair, moment.binding, moment.status))

    def film(self) -> Film:
        """All that is kept, without copying it; later moments do not change it."""
        used = len(self._texts)
        columns: list[Any] = [column[:used] for column in self._columns]
        texts: list[Any] = list(zip(*self._texts, strict=True)) or [(), (), ()]
        return Film(*columns, *texts)

    def clear(self) -> None:
        """Forgets everything."""
        self._columns = self._blank()
        self._texts = []

    def _blank(self) -> list[Array]:
        return [np.empty((2 * self._capacity, *shape)) for shape in self._shapes]

    def _forget(self) -> int:
        """Drops the older half; what was handed out keeps it."""
        old, self._columns = self._columns, self._blank()
        for column, before in zip(self._columns, old, strict=True):
            column[: self._capacity] = before[self._capacity :]
        del self._texts[: self._capacity]
        return self._capacity

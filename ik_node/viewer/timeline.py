"""The data that the viewer displays over time: the fields of Step, recorded or live.

All fields are those of :data:`~ik_node.interfaces.step.STEP_FIELDS`; a field that is added to Step needs no edit here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, TEXT_FIELDS, Status, smallest_singular_value
from ik_node.math.types import Array
from ik_node.recording.run import Run


class TimelineFrame(NamedTuple):
    """One control step. The fields of Step are attributes; what was not computed is NaN."""

    time_s: float
    """On the axis of the timeline."""
    columns: Mapping[str, Any]
    """Array or number of a Step -> value."""
    texts: Mapping[str, Any]
    """Text field of a Step -> value."""

    def __getattr__(self, name: str) -> Any:
        """A field of Step."""
        for fields in (self.columns, self.texts):
            if name in fields:
                return fields[name]
        raise AttributeError(f"TimelineFrame has no attribute '{name}'")

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of J_b with weighted angular rows, m."""
        return float(smallest_singular_value(self.columns["singular_values"]))

    @property
    def status(self) -> Status:
        """Mode and reason."""
        status: Status = self.texts["status"]
        return status


class Timeline(NamedTuple):
    """k control steps as arrays; row i of each belongs to ``times_s[i]``. The fields of Step are attributes."""

    times_s: Array
    """(k,), not decreasing."""
    columns: Mapping[str, Array]
    """Array or number of a Step -> values, (k, *shape)."""
    texts: Mapping[str, tuple[Any, ...]]
    """Text field of a Step -> value per row."""

    def __getattr__(self, name: str) -> Array:
        """An array or number of Step, (k, *shape)."""
        if name in self.columns:
            return self.columns[name]
        raise AttributeError(f"Timeline has no attribute '{name}'")

    @property
    def status(self) -> tuple[Status, ...]:
        """Status per row."""
        return self.texts["status"]

    @property
    def closest_pair(self) -> tuple[tuple[str, ...], ...]:
        """Names of the closest pair per row; empty when not computed."""
        return self.texts["closest_pair"]

    @property
    def sigma_min(self) -> Array:
        """Smallest singular values, (k,), m."""
        return smallest_singular_value(self.columns["singular_values"])

    @property
    def position_error(self) -> Array:
        """Distance of the tool from the desired position, (k,), m."""
        result: Array = np.linalg.norm(self.columns["error_b"][:, :3], axis=1)
        return result

    @property
    def begin_s(self) -> float:
        """Time of the first row; 0 for an empty timeline."""
        return float(self.times_s[0]) if len(self.times_s) else 0.0

    @property
    def end_s(self) -> float:
        """Time of the last row; 0 for an empty timeline."""
        return float(self.times_s[-1]) if len(self.times_s) else 0.0

    def row(self, time_s: float) -> int:
        """The last row at or before ``time_s``, or the first row."""
        return max(int(np.searchsorted(self.times_s, time_s, side="right")) - 1, 0)

    def frame(self, row: int) -> TimelineFrame:
        """One row; raises IndexError if it does not exist."""
        return TimelineFrame(
            float(self.times_s[row]),
            {name: column[row] for name, column in self.columns.items()},
            {name: values[row] for name, values in self.texts.items()},
        )

    def section(self, first: int, last: int) -> Timeline:
        """Rows ``first`` to ``last`` (exclusive)."""
        return Timeline(
            self.times_s[first:last],
            {name: column[first:last] for name, column in self.columns.items()},
            {name: values[first:last] for name, values in self.texts.items()},
        )

    def status_changes(self) -> list[int]:
        """Rows whose status differs from the previous row, and the first row."""
        status = self.status
        # Neighbours are mostly the same object; the identity test is faster than the comparison.
        return [
            row
            for row in range(len(status))
            if row == 0 or (status[row] is not status[row - 1] and status[row] != status[row - 1])
        ]


def timeline_of(run: Run) -> Timeline:
    """The timeline of a recorded run."""
    return Timeline(run.times_s, run.columns, run.texts)


class TimelineBuffer:
    """Ring buffer of the newest frames of a running node."""

    def __init__(self, joints: int, capacity: int) -> None:
        """Keeps at least ``capacity`` and at most twice as many frames of an arm with ``joints`` joints."""
        self._capacity = capacity
        self._shapes = {field.name: field.shape(joints) for field in (*ARRAY_FIELDS, *NUMBER_FIELDS)}
        self.clear()

    def append(self, frame: TimelineFrame) -> None:
        """Adds a frame; one that is not later than the last is ignored."""
        if self._used and frame.time_s <= self._times_s[self._used - 1]:
            return
        if self._used == 2 * self._capacity:
            self._drop_older_half()
        self._times_s[self._used] = frame.time_s
        for name, column in self._columns.items():
            column[self._used] = frame.columns[name]
        for name, values in self._texts.items():
            values.append(frame.texts[name])
        self._used += 1

    def timeline(self) -> Timeline:
        """All kept frames as views; frames added later do not change them."""
        return Timeline(
            self._times_s[: self._used],
            {name: column[: self._used] for name, column in self._columns.items()},
            {name: tuple(values) for name, values in self._texts.items()},
        )

    def clear(self) -> None:
        """Removes all frames."""
        self._used = 0
        self._times_s, self._columns = self._allocate()
        self._texts: dict[str, list[Any]] = {field.name: [] for field in TEXT_FIELDS}

    def _allocate(self) -> tuple[Array, dict[str, Array]]:
        size = 2 * self._capacity
        return np.empty(size), {name: np.empty((size, *shape)) for name, shape in self._shapes.items()}

    def _drop_older_half(self) -> None:
        """Copies the newer half to new arrays, so that timelines given out earlier keep theirs."""
        kept = self._capacity
        old_times_s, old_columns = self._times_s, self._columns
        self._times_s, self._columns = self._allocate()
        self._times_s[:kept] = old_times_s[kept:]
        for name, column in self._columns.items():
            column[:kept] = old_columns[name][kept:]
        for values in self._texts.values():
            del values[:kept]
        self._used = kept

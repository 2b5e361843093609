"""Joint states as drivers really send them: any order, foreign joints between, in pieces, late, or out of order."""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import StateRefused
from ik_node.interfaces.clock import NS, Instant, place
from ik_node.interfaces.samples import JointSample
from ik_node.math.types import Array
from ik_node.settings.groups import StateSettings

Places = NDArray[np.intp] | slice


class JointState(NamedTuple):
    """A complete measurement of the controlled joints."""

    position: Array
    """(n,), rad (m), in the order of the controlled joints."""
    time_ns: int
    """Monotonic time at which it held: of its oldest part."""


class JointStateSnapshot(NamedTuple):
    """What a :class:`JointStateMerger` remembers."""

    position: Array
    time_ns: NDArray[np.int64]
    missing: NDArray[np.bool_]
    last_time_ns: int
    received_ns: int
    skew_ns: int
    out_of_order: int


class JointStateMerger:
    """Collects messages until every controlled joint has a new value."""

    def __init__(self, joints: tuple[str, ...], settings: StateSettings) -> None:
        self._joints = joints
        self.configure(settings)
        self._position = np.full(len(joints), np.nan)
        self._time_ns = np.zeros(len(joints), dtype=np.int64)
        self._missing = np.ones(len(joints), dtype=bool)
        self._places: dict[tuple[str, ...], tuple[Places, Places]] = {}
        self._last_time_ns = 0
        self.received_ns = 0
        """Monotonic arrival of the newest complete state; 0 before the first."""
        self.skew_ns = 0
        """Last age that was not believable, in ROS time; 0 when stamps and clock agree."""
        self.out_of_order = 0
        """Complete states that were older than the one before, and were dropped."""

    def configure(self, settings: StateSettings) -> None:
        """Other settings from now on."""
        self._max_age_ns = round(settings.max_age_s * NS)

    def add(self, sample: JointSample, now: Instant) -> JointState | None:
        """The complete state that ``sample`` finishes, or None.

        A message that holds none of our joints changes nothing. Raises StateRefused when names and positions do not
        match in number or a position of ours is not finite.
        """
        names = sample.names
        if len(sample.position) != len(names):
            raise StateRefused(f"joint state has {len(names)} names but {len(sample.position)} positions")
        ours, theirs = self._places.get(names) or self._match(names)
        position = sample.position[theirs]
        if not len(position):
            return None
        if not all(map(isfinite, position.tolist())):
            bad = [
                name for name, value in zip(np.array(self._joints)[ours], position, strict=True) if not isfinite(value)
            ]
            raise StateRefused(f"joint state is not finite for {', '.join(bad)}")
        stamped = place(sample.stamp_ns, now, self._max_age_ns)
        self.skew_ns = stamped.skew_ns
        if len(position) == len(self._joints):  # as nearly always: all at once
            self._position[ours] = position
            self._time_ns.fill(stamped.time_ns)
            return self._complete(stamped.time_ns, now)
        self._position[ours], self._time_ns[ours], self._missing[ours] = position, stamped.time_ns, False
        return None if self._missing.any() else self._complete(int(self._time_ns.min()), now)

    def _complete(self, time_ns: int, now: Instant) -> JointState | None:
        self._missing.fill(True)
        self.received_ns = now.monotonic_ns
        if time_ns <= self._last_time_ns:
            self.out_of_order += 1
            return None
        self._last_time_ns = time_ns
        return JointState(self._position.copy(), time_ns)

    def missing(self) -> tuple[str, ...]:
        """Controlled joints that no message has named yet."""
        return tuple(name for name, value in zip(self._joints, self._position, strict=True) if np.isnan(value))

    def _match(self, names: tuple[str, ...]) -> tuple[Places, Places]:
        """Where names agree, in our joints and in the message; remembered, as drivers repeat themselves."""
        if len(self._places) > 64:
            self._places.clear()
        if names == self._joints:  # as most drivers have it, and quicker
            self._places[names] = (slice(None), slice(None))
        else:
            where = {name: index for index, name in enumerate(names)}
            pairs = [(ours, where[name]) for ours, name in enumerate(self._joints) if name in where]
            table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
            self._places[names] = (table[:, 0], table[:, 1])
        return self._places[names]

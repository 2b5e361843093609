"""Assembles joint states from messages with joints in any order, other joints, a part of the joints, or old stamps.

This module also decides when joint states are stale: :meth:`JointStateMerger.is_stale`.
"""

from __future__ import annotations

from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import StateRefused
from ik_node.interfaces.clock import NS, Instant, to_monotonic
from ik_node.interfaces.samples import JointSample
from ik_node.math.types import Array
from ik_node.settings.groups import StateSettings

Indices = NDArray[np.intp] | slice


class JointState(NamedTuple):
    """A complete measurement of the controlled joints."""

    position: Array
    """(n,), rad (m), in the order of the controlled joints."""
    time_ns: int
    """Monotonic time of its oldest part."""


class JointStateSnapshot(NamedTuple):
    """Attributes of a :class:`JointStateMerger`."""

    position: Array
    time_ns: NDArray[np.int64]
    missing: NDArray[np.bool_]
    last_time_ns: int
    received_ns: int
    skew_ns: int
    out_of_order: int


class JointStateMerger:
    """Collects messages until every controlled joint has a new position."""

    def __init__(self, joints: tuple[str, ...], settings: StateSettings) -> None:
        self._joints = joints
        self.configure(settings)
        self._position = np.full(len(joints), np.nan)
        self._time_ns = np.zeros(len(joints), dtype=np.int64)
        self._missing = np.ones(len(joints), dtype=bool)
        self._indices: dict[tuple[str, ...], tuple[Indices, Indices]] = {}
        self._last_time_ns = 0
        self.received_ns = 0
        """Monotonic time of arrival of the newest complete state; 0 before the first."""
        self.skew_ns = 0
        """Age of the last stamp in ROS time when it was not plausible; 0 when stamps and clock agree."""
        self.out_of_order = 0
        """Number of complete states that were not newer than their predecessor, and were dropped."""

    def configure(self, settings: StateSettings) -> None:
        """Applies changed settings."""
        self._max_age_ns = round(settings.max_stamp_age_s * NS)
        self.timeout_s = settings.timeout_s
        """Time without a complete state after which :meth:`is_stale` is true."""

    def add(self, sample: JointSample, now: Instant) -> JointState | None:
        """Adds a message.

        Args:
            sample: The message; one without controlled joints changes nothing.
            now: Time of arrival.

        Returns:
            The complete state when ``sample`` completes one, else None.

        Raises:
            StateRefused: The numbers of names and positions differ, or the position of a joint is not finite.
        """
        names = sample.names
        if len(sample.position) != len(names):
            raise StateRefused(f"joint state has {len(names)} names but {len(sample.position)} positions")
        own, given = self._indices.get(names) or self._match(names)
        position = sample.position[given]
        if not len(position):
            return None
        if not all(map(isfinite, position.tolist())):
            bad = [
                name for name, value in zip(np.array(self._joints)[own], position, strict=True) if not isfinite(value)
            ]
            raise StateRefused(f"joint state is not finite for {', '.join(bad)}")
        stamped = to_monotonic(sample.stamp_ns, now, self._max_age_ns)
        self.skew_ns = stamped.skew_ns
        if len(position) == len(self._joints):  # the usual case: all joints in one message
            self._position[own] = position
            self._time_ns.fill(stamped.time_ns)
            return self._complete(stamped.time_ns, now)
        self._position[own], self._time_ns[own], self._missing[own] = position, stamped.time_ns, False
        return None if self._missing.any() else self._complete(int(self._time_ns.min()), now)

    def _complete(self, time_ns: int, now: Instant) -> JointState | None:
        self._missing.fill(True)
        self.received_ns = now.monotonic_ns
        if time_ns <= self._last_time_ns:
            self.out_of_order += 1
            return None
        self._last_time_ns = time_ns
        return JointState(self._position.copy(), time_ns)

    def is_stale(self, now: Instant) -> bool:
        """True when no complete state has arrived for longer than ``state.timeout_s``."""
        return now.monotonic_ns - self.received_ns > self.timeout_s * NS

    def missing(self) -> tuple[str, ...]:
        """Names of the controlled joints for which no position has arrived yet."""
        return tuple(name for name, value in zip(self._joints, self._position, strict=True) if np.isnan(value))

    def _match(self, names: tuple[str, ...]) -> tuple[Indices, Indices]:
        """Indices of the common joints, in the controlled joints and in the message; cached by the message's names."""
        if len(self._indices) > 64:
            self._indices.clear()
        if names == self._joints:  # the usual case, and faster
            self._indices[names] = (slice(None), slice(None))
        else:
            index_of = {name: index for index, name in enumerate(names)}
            pairs = [(own, index_of[name]) for own, name in enumerate(self._joints) if name in index_of]
            table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
            self._indices[names] = (table[:, 0], table[:, 1])
        return self._indices[names]

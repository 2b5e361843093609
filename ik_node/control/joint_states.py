"""Assembles joint states from messages with joints in any order, other joints, a part of the joints, or old stamps.

A message is no measurement when it names a joint twice with different positions, or holds positions that are not
possible (:mod:`ik_node.control.plausibility`). One such message is ignored; when others contradict it again within
``CONTRADICTION_S``, it is not known which are right, and all are refused. This module also decides when joint states
are stale: :meth:`JointStateMerger.is_stale`.
"""

from __future__ import annotations

from collections import Counter
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.control import plausibility
from ik_node.errors import StateRefused
from ik_node.interfaces.clock import NS, Instant, to_monotonic
from ik_node.interfaces.samples import JointSample
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.math.angles import joint_difference
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

Indices = NDArray[np.intp] | slice

CONTRADICTION = "joint states contradict each other"
"""Begin of the status text while several sources of joint states contradict each other."""
CONTRADICTION_S = 1.0
"""Two outliers within this time, with accepted states between them, are a second source rather than outliers: programs
that publish joint states by themselves do so at 10 Hz or more. All states are refused until none was for this long."""


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
    jumped: Array
    jumped_ns: NDArray[np.int64]
    jumped_since_ns: NDArray[np.int64]
    rejected_ns: int
    accepted_since: bool
    contradicted_until_ns: int
    reason: str


class _Match(NamedTuple):
    """The controlled joints in the names of a message."""

    own: Indices
    """Indices of the joints, in the order of the controlled joints."""
    given: Indices
    """Their indices in the message."""
    joints: NDArray[np.intp]
    """``own`` as an array."""
    repeated: tuple[tuple[str, NDArray[np.intp]], ...]
    """Joints that are named several times, with all their indices in the message."""


class JointStateMerger:
    """Collects messages until every controlled joint has a new position."""

    def __init__(self, robot: Robot, settings: Settings) -> None:
        self._robot = robot
        self._joints = joints = robot.joints
        self.configure(settings)
        self._position = np.full(len(joints), np.nan)
        self._time_ns = np.zeros(len(joints), dtype=np.int64)
        self._missing = np.ones(len(joints), dtype=bool)
        self._indices: dict[tuple[str, ...], _Match] = {}
        self._jumped = np.full(len(joints), np.nan)
        self._jumped_ns = np.zeros(len(joints), dtype=np.int64)
        self._jumped_since_ns = np.zeros(len(joints), dtype=np.int64)
        self._rejected_ns = 0
        self._accepted_since = False
        self._contradicted_until_ns = 0
        self._reason = ""
        self.warning = ""
        """Why the last message was not used, without numbers; empty when it was."""
        self.settled = ""
        """Which joint jumped before the last message, which was accepted as the new position; empty for none."""
        self._last_time_ns = 0
        self.received_ns = 0
        """Monotonic time of arrival of the newest complete state; 0 before the first."""
        self.skew_ns = 0
        """Age of the last stamp in ROS time when it was not plausible; 0 when stamps and clock agree."""
        self.out_of_order = 0
        """Number of complete states that were not newer than their predecessor, and were dropped."""

    def configure(self, settings: Settings) -> None:
        """Applies changed settings; raises SettingsError when the limits do not fit the robot."""
        self._plausible = plausibility.plausible(self._robot, settings)
        self._max_age_ns = round(settings.state.max_stamp_age_s * NS)
        self.timeout_s = settings.state.timeout_s
        """Time without a complete state after which :meth:`is_stale` is true."""

    def add(self, sample: JointSample, now: Instant) -> JointState | None:
        """Adds a message. Sets :attr:`warning` and :attr:`settled`.

        Args:
            sample: The message; one without controlled joints changes nothing.
            now: Time of arrival.

        Returns:
            The complete state when ``sample`` completes one, else None.

        Raises:
            StateRefused: The numbers of names and positions differ, the position of a controlled joint is not finite,
                or the joint states contradict each other.
        """
        names = sample.names
        self.warning = self.settled = ""
        match = self._indices.get(names) or self._match(names)
        own, joints = match.own, match.joints
        if not len(joints):
            return None
        if len(sample.position) != len(names):
            if not len(sample.position):  # velocities or efforts alone are a valid message
                self.warning = f"joint state without positions for {', '.join(self._joints[i] for i in joints)}"
                return None
            raise StateRefused(f"joint state has {len(names)} names but {len(sample.position)} positions")
        position = sample.position[match.given]
        if not all(map(isfinite, position.tolist())):
            bad = [
                name for name, value in zip(np.array(self._joints)[own], position, strict=True) if not isfinite(value)
            ]
            raise StateRefused(f"joint state is not finite for {', '.join(bad)}")
        for name, places in match.repeated:
            values = sample.position[places]
            if not (values == values[0]).all():
                listed = ", ".join(f"{value:.3g}" for value in values)
                self._reject(f"joint '{name}' stands twice in a joint state", f" at {listed}", now)
                return None
        stamped = to_monotonic(sample.stamp_ns, now, self._max_age_ns)
        status, joint = plausibility.judge(
            self._plausible,
            joints,
            position,
            stamped.time_ns,
            now.monotonic_ns,
            self._position,
            self._time_ns,
            self._jumped,
            self._jumped_ns,
            self._jumped_since_ns,
            round(self.timeout_s * NS),
        )
        if status != plausibility.POSSIBLE:
            self._judged(status, joint, float(position[joints == joint][0]), now)
            if not self.settled:
                return None
        self._accepted_since = True
        if now.monotonic_ns - self._rejected_ns > round(CONTRADICTION_S * NS):
            self._reason = ""
        self.skew_ns = stamped.skew_ns
        if len(position) == len(self._joints):  # the usual case: all joints in one message
            self._position[own] = position
            self._time_ns.fill(stamped.time_ns)
            return self._complete(stamped.time_ns, now)
        self._position[own], self._time_ns[own], self._missing[own] = position, stamped.time_ns, False
        return None if self._missing.any() else self._complete(int(self._time_ns.min()), now)

    def _judged(self, status: int, joint: int, position: float, now: Instant) -> None:
        """Rejects a message with a position that is not possible, or sets :attr:`settled`."""
        name = self._joints[joint]
        if status == plausibility.OUTSIDE:
            self._reject(f"the position of joint '{name}' is far outside its limits", f": {position:.4g}", now)
            return
        distance = joint_difference(self._position[joint], position, self._robot.continuous[joint])
        text = f"joint '{name}' jumped"
        if status == plausibility.JUMPED:
            self._reject(text, f" by {distance:.3g}, more than it can move in that time", now)
            return
        self.settled = f"{text} by {distance:.3g}, to a position that has lasted for {self.timeout_s:g} s"
        self._jumped.fill(np.nan)

    def _reject(self, text: str, detail: str, now: Instant) -> None:
        """Ignores a message; raises StateRefused when it contradicts others repeatedly."""
        contradicts = self._accepted_since and 0 < self._rejected_ns >= now.monotonic_ns - round(CONTRADICTION_S * NS)
        contradicted = now.monotonic_ns < self._contradicted_until_ns
        self._rejected_ns, self._accepted_since = now.monotonic_ns, False
        if contradicts and not contradicted:
            self._reason = f"{CONTRADICTION}: {text}{detail}, and back; is there a second publisher?"
        elif not contradicted:
            self.warning = f"joint state ignored: {text}"
            if not self._reason.startswith(text):  # numbers of the first one, so that the status does not change
                self._reason = text + detail
        if contradicts or contradicted:
            self._contradicted_until_ns = now.monotonic_ns + round(CONTRADICTION_S * NS)
            raise StateRefused(self._reason)

    def _complete(self, time_ns: int, now: Instant) -> JointState | None:
        self._missing.fill(True)
        if now.monotonic_ns < self._contradicted_until_ns:
            raise StateRefused(self._reason)
        if time_ns <= self._last_time_ns:  # no sign of life: a driver may repeat its last state
            self.out_of_order += 1
            return None
        self.received_ns = now.monotonic_ns
        self._last_time_ns = time_ns
        return JointState(self._position.copy(), time_ns)

    def is_stale(self, now: Instant) -> bool:
        """True when no complete state has arrived for longer than ``state.timeout_s``."""
        return now.monotonic_ns - self.received_ns > self.timeout_s * NS

    def stale_reason(self) -> str:
        """Status text when :meth:`is_stale`: names the joints that are missing, or what is wrong with the messages."""
        text = f"no joint state for {self.timeout_s:g} s"
        if self._rejected_ns > self.received_ns:
            return f"{text}: {self._reason}"
        if self._missing.any() and not self._missing.all():
            return f"{text} of {', '.join(np.array(self._joints)[self._missing])}"
        return text

    def rejected(self, now: Instant) -> str:
        """Why no message has been accepted for ``state.timeout_s``; empty while there are none, or accepted ones."""
        is_recent = now.monotonic_ns - self._rejected_ns <= self.timeout_s * NS
        return self._reason if 0 < self._rejected_ns > self.received_ns and is_recent and self.is_stale(now) else ""

    def waiting_status(self, now: Instant) -> Status | None:
        """Status while the first position of a joint has not arrived, or no message is accepted; None otherwise."""
        if self.rejected(now):
            return Status(Level.ERROR, Mode.WAITING, self.stale_reason())
        if missing := self.missing():
            return Status(Level.OK, Mode.WAITING, f"waiting for a joint state of {', '.join(missing)}")
        return None

    @property
    def skew_warning(self) -> str:
        """Status text while the stamps are not plausible; empty otherwise."""
        return "joint state stamps disagree with this clock; the time of arrival is used" if self.skew_ns else ""

    def missing(self) -> tuple[str, ...]:
        """Names of the controlled joints for which no position has arrived yet."""
        return tuple(name for name, value in zip(self._joints, self._position, strict=True) if np.isnan(value))

    def _match(self, names: tuple[str, ...]) -> _Match:
        """Indices of the common joints, in the controlled joints and in the message; cached by the message's names."""
        if len(self._indices) > 64:
            self._indices.clear()
        if names == self._joints:  # the usual case, and faster
            match = _Match(slice(None), slice(None), np.arange(len(names)), ())
        else:
            index_of = {name: index for index, name in enumerate(names)}
            pairs = [(own, index_of[name]) for own, name in enumerate(self._joints) if name in index_of]
            table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
            count = Counter(names)
            repeated = tuple(
                (name, np.array([index for index, other in enumerate(names) if other == name]))
                for name in self._joints
                if count[name] > 1
            )
            match = _Match(table[:, 0].copy(), table[:, 1].copy(), table[:, 0].copy(), repeated)
        self._indices[names] = match
        return match

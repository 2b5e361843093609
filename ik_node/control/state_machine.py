"""Which mode the controller is in, and how the arm comes to rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.control.ramp import Ramp, ramp_to_zero
from ik_node.control.status import CLOSED_LOOP, StatusKeeper
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.math.types import Array

MOVING = (*CLOSED_LOOP, Mode.RAMPING)
"""Modes in which a velocity may be standing at the robot."""
HELD_BACK = (Mode.PAUSED, Mode.FAULT)
"""Modes that only a request ends."""


class StateMachineSnapshot(NamedTuple):
    """What a :class:`Supervision` remembers, beside its status."""

    ramp: Ramp | None
    rest: Status


class Supervision:
    """Modes and the ways between them.

    ``rest`` is what the arm comes to once nothing moves: it outlasts the ramp that leads there, and decides what the
    next joint state may do. Paused and at fault it may do nothing; stopped and waiting it may begin anew.
    """

    def __init__(self) -> None:
        self.rest = Status(Level.OK, Mode.WAITING, "waiting for the first joint state")
        self.says = StatusKeeper(self.rest)
        self.ramp: Ramp | None = None

    @property
    def mode(self) -> Mode:
        """The present one."""
        return self.says.status.mode

    @property
    def moving(self) -> bool:
        """A velocity may be standing at the robot."""
        return self.mode in MOVING

    @property
    def closed_loop(self) -> bool:
        """A control law is at work."""
        return self.mode in CLOSED_LOOP

    @property
    def held_back(self) -> bool:
        """Only a request leads on from here: :meth:`resume` or :meth:`reset`."""
        return self.rest.mode in HELD_BACK

    def ramp_down(self, velocity: Array, acceleration: Array, now: Instant, rest: Status) -> None:
        """Begins a ramp from ``velocity`` (n,) that ends in ``rest``; goes there at once where nothing moves."""
        self.rest = rest
        if velocity.any():
            if self.ramp is None:
                self.ramp = ramp_to_zero(velocity, acceleration, now.monotonic_ns)
            self.says.set(Status(rest.level, Mode.RAMPING, rest.reason))
        else:
            self.says.set(rest)

    def ramp_velocity(self, now: Instant) -> Array:
        """The ramp's joint velocity (n,) now; at its end the arm is at rest. To be asked only while there is a ramp."""
        if self.ramp is None:
            return np.zeros(0)
        velocity = self.ramp.at(now.monotonic_ns)
        if self.ramp.finished(now.monotonic_ns):
            self.ramp = None
            self.says.set(self.rest)
        return velocity

    def stop(self, level: Level, reason: str) -> None:
        """Zeros at once; what was held back before stays so."""
        self.ramp = None
        if not self.held_back:
            self.rest = Status(level, Mode.STOPPED, reason)
        self.says.set(self.rest)

    def fault(self, reason: str) -> None:
        """Zeros at once, until :meth:`reset`."""
        self.ramp = None
        self.rest = Status(Level.ERROR, Mode.FAULT, f"{reason}; stopped until reset")
        self.says.set(self.rest)

    def resume(self) -> None:
        """Leaves a pause, or the way to one; a ramp that has begun is finished first."""
        if self.rest.mode is Mode.PAUSED:
            self._begin_anew("waiting for a joint state")

    def reset(self) -> None:
        """Leaves a pause or a fault."""
        if self.held_back:
            self._begin_anew("reset; waiting for a joint state")

    def _begin_anew(self, reason: str) -> None:
        self.rest = Status(Level.OK, Mode.WAITING, reason)
        if self.ramp is None:
            self.says.set(self.rest)

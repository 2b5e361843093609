"""Which mode the controller is in, and how the arm comes to rest.

What stops the arm, and how:

================================================  =============================================================
cause                                             response
================================================  =============================================================
the target stream ends or pauses                  the reference brakes within its bounds; the last pose is held
pause, deactivation, a signal                     ramp to zero within the acceleration limits, then no commands
no subscriber on the command topic                the same ramp; continues with the next subscriber
joint states, or this machine, too slow           the same ramp; continues after 2 s at a distinctly higher rate
not followed, or moved by something else          the same ramp; a new attempt after 1 s
joint states stale                                zero velocity at once; continues from the measured position
the process was held up (stopped, starved)        the same, 0.1 s later
either of these again within 10 s                 the same, 2 s later; after each further one twice as long
joint states not finite                           zero velocity at once; continues with the next finite ones
joint states not possible                         ignored; zero velocity at once if that lasts
joint states that contradict each other           zero velocity at once; continues after 1 s without contradiction
a position that has jumped, and stays there       zero velocity at once; continues from there
an exception or a non-finite result               zero velocity at once; stays stopped until reset
================================================  =============================================================
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ik_node.control.ramp import Ramp, ramp_to_zero
from ik_node.control.status import StatusReporter
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import CLOSED_LOOP, Level, Mode, Status
from ik_node.math.types import Array

MOVING = (*CLOSED_LOOP, Mode.RAMPING)
"""Modes in which the last command may not be zero."""
LATCHED = (Mode.PAUSED, Mode.FAULT)
"""Modes that end only on request."""


class StateMachineSnapshot(NamedTuple):
    """Attributes of a :class:`StateMachine`, without those of its reporter."""

    ramp: Ramp | None
    idle_status: Status


class StateMachine:
    """Modes of the controller and the transitions between them.

    ``idle_status`` is the status after the arm has come to rest. It is kept during the ramp to zero and determines what
    the next joint state may do: nothing when paused or in a fault, start again when stopped or waiting.
    """

    def __init__(self) -> None:
        self.idle_status = Status(Level.OK, Mode.WAITING, "waiting for the first joint state")
        self.reporter = StatusReporter(self.idle_status)
        self.ramp: Ramp | None = None

    @property
    def mode(self) -> Mode:
        """Present mode."""
        return self.reporter.status.mode

    @property
    def moving(self) -> bool:
        """True when the last command may not be zero."""
        return self.mode in MOVING

    @property
    def closed_loop(self) -> bool:
        """True while the control law computes the commands."""
        return self.mode in CLOSED_LOOP

    @property
    def latched(self) -> bool:
        """True when only :meth:`resume` or :meth:`reset` ends this state."""
        return self.idle_status.mode in LATCHED

    def ramp_down(self, velocity: Array, acceleration: Array, now: Instant, idle_status: Status) -> None:
        """Starts a ramp to zero, or changes to the idle status at once when the velocity is zero.

        Args:
            velocity: Present command, (n,), rad/s (m/s).
            acceleration: Limits, (n,), rad/s2 (m/s2).
            now: Present time.
            idle_status: Status at the end of the ramp.
        """
        self.idle_status = idle_status
        if velocity.any():
            if self.ramp is None:
                self.ramp = ramp_to_zero(velocity, acceleration, now.monotonic_ns)
            self.reporter.set(Status(idle_status.level, Mode.RAMPING, idle_status.reason))
        else:
            self.reporter.set(idle_status)

    def change_ramp(self, velocity: Array, acceleration: Array, commanded_ns: int) -> None:
        """Continues a ramp with other acceleration limits (n,), from the last command (n,) and its monotonic time."""
        if self.ramp is not None:  # the same straight line when the acceleration limits are the same
            self.ramp = ramp_to_zero(velocity, acceleration, commanded_ns)

    def ramp_velocity(self, now: Instant) -> Array:
        """Joint velocity of the ramp at the present time, (n,), rad/s (m/s); (0,) when there is no ramp."""
        if self.ramp is None:
            return np.zeros(0)
        velocity = self.ramp.at(now.monotonic_ns)
        if self.ramp.finished(now.monotonic_ns):
            self.ramp = None
            self.reporter.set(self.idle_status)
        return velocity

    def stop(self, level: Level, reason: str) -> None:
        """Stops at once, without a ramp; a latched state stays latched."""
        self.ramp = None
        if not self.latched:
            self.idle_status = Status(level, Mode.STOPPED, reason)
        self.reporter.set(self.idle_status)

    def fault(self, reason: str) -> None:
        """Stops at once, without a ramp, until :meth:`reset`."""
        self.ramp = None
        self.idle_status = Status(Level.ERROR, Mode.FAULT, f"{reason}; stopped until reset")
        self.reporter.set(self.idle_status)

    def resume(self) -> None:
        """Ends a pause; a ramp that has started is completed first."""
        if self.idle_status.mode is Mode.PAUSED:
            self._wait("waiting for a joint state")

    def reset(self) -> None:
        """Ends a pause or a fault."""
        if self.latched:
            self._wait("reset; waiting for a joint state")

    def _wait(self, reason: str) -> None:
        self.idle_status = Status(Level.OK, Mode.WAITING, reason)
        if self.ramp is None:
            self.reporter.set(self.idle_status)

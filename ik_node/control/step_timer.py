"""Timing of the control steps: which joint states make a step, their mean interval, and whether they are fast enough.

Joint states that arrive and clock calls that are made are two measurements. Both wait in the same queue of the
executor, so late clock calls mean that this machine does not keep up, whatever the driver publishes: of the joint
states that wait DDS keeps the newest only, and those that it drops cannot be counted here. With clock calls on time the
joint states themselves are too slow.

A time without any of these calls is a hold-up: the process did not run, or one call took that long.

``rate_hz`` is the highest rate of control steps. A driver that is slower from its start on, as a controller_manager
with its default of 100 Hz, is no fault: its rate is measured, and replaces ``rate_hz`` wherever a rate is expected. A
driver that becomes slower later is a fault.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.interfaces.clock import NS
from ik_node.interfaces.delivery import CLOCK_PERIOD_S, HOLD_UP_S, LATE_PERIODS

INTERVAL_SMOOTHING = 0.02
"""Weight of the newest interval in the running mean."""
RATE_WINDOW_S = 0.5
"""Time constant of the measured rates: long beside the bursts in which a busy machine works (some 10 ms)."""
MIN_RATE_FRACTION = 0.3
"""Below this fraction of ``rate_hz`` the arm is stopped."""
RESTART_FRACTION = 0.5
"""From this fraction of ``rate_hz`` on the arm may start again, after :data:`RECOVERY_S`."""
RECOVERY_S = 2.0
"""Time at that rate before the arm starts again; after a silence that repeats, time since its stop."""
MAX_RECOVERY_S = 16.0
"""That time doubles with each stop that follows soon, because a stopped arm costs less computing time
than a moving one; at most to this."""
RELAPSE_S = 10.0
"""A stop within this time after the last one, or after the last restart, is its repetition."""
CLOCK_FRACTIONS = (0.7, 0.9)
"""Below the first fraction of their rate the clock calls are late and the machine does not keep up; above the second it
does."""
SLOW_FRACTIONS = (0.7, 0.85)
"""Fractions of ``rate_hz``: below the first a machine that does not keep up is reported, above the second no more."""


MEASURED_S = 0.5
"""Time from the first joint state, and from the end of a silence, in which the rate of the driver is measured."""
SAME_FRACTION = 0.15
"""Rates that differ by less than this fraction are the same: counts vary, and drivers are not exact."""
LEAST_HZ = 10.0
"""Least value of ``rate_hz``, and of the rate that replaces it."""


class EventRate(NamedTuple):
    """Rate of events; immutable, so that a snapshot may hold it."""

    hz: float
    """Mean over about :data:`RATE_WINDOW_S`."""
    last_ns: int = 0
    """Monotonic time of the last event; 0: the next event only begins an interval."""

    def after(self, now_ns: int) -> EventRate:
        """The rate after an event at a monotonic time."""
        if self.last_ns == 0:
            return EventRate(self.hz, now_ns)
        interval_s = (now_ns - self.last_ns) / NS
        if interval_s >= RATE_WINDOW_S:
            return EventRate(1.0 / interval_s, now_ns)
        return EventRate(self.hz + (1.0 - self.hz * interval_s) / RATE_WINDOW_S, now_ns)


class TimerSnapshot(NamedTuple):
    """Attributes of a :class:`StepTimer`."""

    interval_s: float
    due_ns: int
    due: EventRate
    clock: EventRate
    too_slow: str
    warning: str
    slow_ns: int
    stopped_ns: int
    recovery_s: float
    states: int
    steps_late: int
    clock_calls: int
    called_ns: int = 0
    held_up_ns: int = 0
    hold_ups: int = 0
    hold_ups_ns: int = 0
    state_interval_s: float = 0.0
    followed_hz: float = 0.0
    measures: bool = True
    measured_from_ns: int = 0
    measured: int = 0


class StepTimer:
    """Limits the mean rate of the control steps, and measures whether joint states and clock calls come in time."""

    def __init__(self, rate_hz: float) -> None:
        """``rate_hz``: largest mean rate of the control steps."""
        self._least_period_ns = round(NS / rate_hz)
        self.interval_s = 1.0 / rate_hz
        """Running mean of the interval between control steps, s."""
        self.state_interval_s = self.interval_s
        """Time between the measurements of the last two joint states that made control steps, s."""
        self.too_slow = ""
        """Why the rate is too low to move; empty when it is high enough. Has hysteresis in rate and time."""
        self.warning = ""
        """Status text while the machine does not keep up but is fast enough to move; empty otherwise."""
        self.recovery_s = 0.0
        """Last result of :meth:`restart_delay_s`."""
        self.states = 0
        """Number of complete joint states that arrived."""
        self.steps_late = 0
        """Number of joint states that make a control step, and arrived late: see :data:`LATE_PERIODS`."""
        self.clock_calls = 0
        """Number of clock calls; one is wanted every :data:`CLOCK_PERIOD_S`."""
        self.held_up_ns = 0
        """Monotonic time at which the last hold-up ended; 0 for none."""
        self.hold_ups = 0
        """Number of hold-ups, see :data:`HOLD_UP_S`."""
        self._rate_hz = rate_hz
        self._followed_hz = 0.0  # 0: rate_hz
        self._measures, self._measured_from_ns, self._measured = True, 0, 0
        self._due_ns = 0
        self._due = EventRate(rate_hz)
        self._clock = EventRate(1.0 / CLOCK_PERIOD_S)
        self._slow_ns = self._stopped_ns = self._called_ns = self._hold_ups_ns = 0

    @property
    def expected_hz(self) -> float:
        """``rate_hz``, or the rate of the driver when that is lower, from :data:`MEASURED_S` after its start on."""
        return self._followed_hz or self._rate_hz

    @property
    def period_s(self) -> float:
        """Expected time between control steps, s."""
        return 1.0 / self.expected_hz

    def is_due(self, time_ns: int, now_ns: int) -> bool:
        """Counts a joint state and decides whether it makes a control step; keeps the mean rate below rate_hz.

        Args:
            time_ns: Monotonic time of the measurement.
            now_ns: Monotonic time of its arrival.

        Returns:
            True when the joint state makes a control step. :attr:`too_slow` and :attr:`warning` are then up to date.
        """
        self.states += 1
        period_ns = self._least_period_ns
        if time_ns < self._due_ns - period_ns // 4:
            return False
        self._due_ns = max(self._due_ns, time_ns - period_ns) + period_ns
        if self._due.last_ns and now_ns - self._due.last_ns > LATE_PERIODS * NS / self.expected_hz:
            self.steps_late += 1
        self._due = self._due.after(now_ns)
        self._follow(now_ns)
        self._evaluate(now_ns)
        return True

    def add_interval(self, interval_s: float) -> None:
        """Adds the time between two control steps to the running mean."""
        self.state_interval_s = interval_s
        self.interval_s += INTERVAL_SMOOTHING * (interval_s - self.interval_s)

    def reset_interval(self) -> None:
        """Sets the running mean to the nominal period."""
        self.interval_s = self.period_s

    def add_call(self, now_ns: int) -> None:
        """Adds the monotonic time of a joint state, of any kind, or of a clock call."""
        if self._called_ns and now_ns - self._called_ns > HOLD_UP_S * NS:
            self.hold_ups, self._hold_ups_ns = self.hold_ups + 1, self._hold_ups_ns + now_ns - self._called_ns
            self.held_up_ns = now_ns
        self._called_ns = now_ns

    def add_clock_call(self, now_ns: int) -> None:
        """Counts a clock call at a monotonic time."""
        self.add_call(now_ns)
        self.clock_calls += 1
        self._clock = self._clock.after(now_ns)

    def skip_silence(self, now_ns: int) -> None:
        """Leaves a silence of the joint states, which is reported as such, out of their rate. It ends now."""
        self._due = self._due._replace(last_ns=0)
        self._slow_ns = now_ns
        self._measures, self._measured_from_ns = True, 0

    def skip_clock_calls(self) -> None:
        """Leaves a time without clock calls, before the node is active, out of their rate. It ends now."""
        self._clock, self._called_ns = self._clock._replace(last_ns=0), 0

    def restart_delay_s(self, now_ns: int, shortest_s: float = 0.0) -> float:
        """Time without control after a stop at a monotonic time, s.

        Args:
            now_ns: Time of the stop.
            shortest_s: Time when the last stop, or restart, is longer than :data:`RELAPSE_S` ago.

        Returns:
            ``shortest_s``; otherwise twice the last time, from :data:`RECOVERY_S` to :data:`MAX_RECOVERY_S`. While
            :attr:`too_slow` holds, the time that it names.
        """
        if self.too_slow:
            return self.recovery_s
        repeats = 0 < self._stopped_ns >= now_ns - round((RELAPSE_S + self.recovery_s) * NS)
        self.recovery_s = min(max(2.0 * self.recovery_s, RECOVERY_S), MAX_RECOVERY_S) if repeats else shortest_s
        self._stopped_ns = now_ns
        return self.recovery_s

    def counts(self) -> dict[str, int]:
        """Numbers of joint states, of late ones, of clock calls and of hold-ups, and the total time of these."""
        return {
            "joint_states": self.states,
            "steps_late": self.steps_late,
            "clock_calls": self.clock_calls,
            "hold_ups": self.hold_ups,
            "hold_ups_ms": self._hold_ups_ns * 1000 // NS,
            "expected_hz": round(self.expected_hz),
        }

    def _follow(self, now_ns: int) -> None:
        """Measures the rate of the driver after its start; a higher rate later is followed up to ``rate_hz``."""
        if not self._measures:
            if self._due.hz > self.expected_hz / (1.0 - SAME_FRACTION):
                self._set_expected(self._due.hz)
        elif self._measured_from_ns == 0 or self._machine_is_late():
            self._measured_from_ns, self._measured = now_ns, 0
        else:
            self._measured += 1
            elapsed_s = (now_ns - self._measured_from_ns) / NS
            if elapsed_s >= MEASURED_S:
                self._measures = False
                self._set_expected(self._measured / elapsed_s)

    def _set_expected(self, hz: float) -> None:
        is_slower = hz < (1.0 - SAME_FRACTION) * self._rate_hz
        self._followed_hz = max(hz, LEAST_HZ) if is_slower else 0.0
        if is_slower:
            self._due = self._due._replace(hz=hz)

    def _machine_is_late(self) -> bool:
        return self._clock.hz * CLOCK_PERIOD_S < CLOCK_FRACTIONS[0]

    def _evaluate(self, now_ns: int) -> None:
        hz, expected_hz = self._due.hz, self.expected_hz
        is_late, is_in_time = self._machine_is_late(), self._clock.hz * CLOCK_PERIOD_S > CLOCK_FRACTIONS[1]
        if self.too_slow:
            if hz < RESTART_FRACTION * expected_hz:
                self._slow_ns = now_ns
            elif now_ns - self._slow_ns >= self.recovery_s * NS:
                self.too_slow, self._stopped_ns = "", now_ns
        elif hz < MIN_RATE_FRACTION * expected_hz:
            self._slow_ns = now_ns
            self.too_slow = self._reason(is_late, self.restart_delay_s(now_ns, RECOVERY_S))
        slow, fast = SLOW_FRACTIONS
        if self.too_slow or is_in_time or hz > fast * expected_hz:
            self.warning = ""
        elif is_late and hz < slow * expected_hz and not self.warning:
            self.warning = f"this machine makes fewer than {slow * expected_hz:.0f} control steps per second"

    def _reason(self, is_late: bool, delay_s: float) -> str:
        expected_hz = self.expected_hz
        least, whole = f"{MIN_RATE_FRACTION * expected_hz:.0f}", "rate_hz"
        if self._followed_hz:
            whole = f"the {expected_hz:.0f} Hz at which they came"
        what = (
            f"this machine makes fewer than {least} control steps per second"
            if is_late
            else f"joint states arrive slower than {least} Hz"
        )
        again = f"continues after {delay_s:g} s above {RESTART_FRACTION * expected_hz:.0f} Hz"
        return f"{what}, {MIN_RATE_FRACTION:g} of {whole}; {again}"

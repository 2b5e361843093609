"""Detection that the process itself was held up: stopped by a signal, suspended, or starved by its machine.

No command leaves a process that is held up, so another one may have stopped the arm meanwhile, and messages that have
queued up are old. The controller reads no clock; it detects the gap between the times of its calls.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.control.joint_states import JointStateMerger
from ik_node.control.state_machine import StateMachine
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.delivery import CLOCK_PERIOD_S

CLOCK_MARGIN_S = 5.0 * CLOCK_PERIOD_S
"""Five periods of the clock calls. They detect silent joint states within one period of ``state.timeout_s``; a silence
that is found this much later means that they were not made."""
RESTART_S = 0.1
"""Time without control after a hold-up. Messages that queued up are processed in it; their positions are old."""
MAX_RAMP_GAP_PERIODS = 2.0
"""Control periods between two steps of a ramp without joint states."""


class Late(NamedTuple):
    """Why the last command is out of date."""

    reason: str
    """Text for the status."""
    is_held_up: bool
    """True when the process was held up, so that queued messages are old."""


def reason_when_late(
    state_machine: StateMachine, joint_states: JointStateMerger, since_step_ns: int, period_s: float, now: Instant
) -> Late | None:
    """Decides whether the last command of a moving arm is out of date, at the begin of a call.

    Args:
        state_machine: Present mode.
        joint_states: Received joint states.
        since_step_ns: Time since the last command, ns.
        period_s: Control period, s.
        now: Time of the call.

    Returns:
        The reason for zero velocity at once; None when there is none.
    """
    timeout_s = joint_states.timeout_s
    if state_machine.closed_loop and joint_states.is_stale(now):
        elapsed_s = (now.monotonic_ns - joint_states.received_ns) / NS
        late = Late(joint_states.stale_reason(), False)
    elif state_machine.ramp is not None:
        elapsed_s = since_step_ns / NS - MAX_RAMP_GAP_PERIODS * period_s
        late = None
    else:
        return None
    if elapsed_s <= timeout_s + CLOCK_MARGIN_S:
        return late
    return Late(f"the node was held up for {elapsed_s:.2f} s, longer than state.timeout_s", True)

"""Status texts about joint states and targets that came late, with the cause as far as the node can know it.

A hold-up of this process and late messages look alike in the commands. The times of the calls tell them apart: clock
calls are made in any case, so a time without any call is a hold-up. A joint state that was measured in time and makes a
late control step has waited on this machine.
"""

from __future__ import annotations

from ik_node.control.joint_states import JointStateMerger
from ik_node.control.step_timer import StepTimer
from ik_node.interfaces.delivery import LATE_PERIODS
from ik_node.targets.stream.tracking_filter import BRIDGE_PERIODS

HELD = "a command was held for longer than hold_periods"
HELD_UP = "this machine held up the node"
GAP = f"no target_pose came for {BRIDGE_PERIODS:g} sample periods, and the reference decelerated"


def late_conditions(timer: StepTimer, joint_states: JointStateMerger, held_since_ns: int, gap_ns: int) -> list[str]:
    """Conditions of a control step for the status text.

    Args:
        timer: Rates and hold-ups.
        joint_states: Received joint states.
        held_since_ns: Monotonic time of the last command if it was held for too long; 0 otherwise.
        gap_ns: Monotonic begin of a gap in the targets that has ended; 0 for none.
    """
    found = [text for text in (timer.warning, joint_states.skew_warning) if text]
    if held_since_ns:
        has_waited = timer.state_interval_s <= LATE_PERIODS * timer.period_s
        is_held_up = has_waited or timer.held_up_ns > held_since_ns
        found.append(f"{HELD}: {HELD_UP if is_held_up else 'joint states came late'}")
    if gap_ns:
        found.append(f"{GAP}: {HELD_UP if timer.held_up_ns > gap_ns else 'targets are late or lost'}")
    return found

"""What a control step adds to the status."""

from __future__ import annotations

from ik_node.control.joint_states import JointStateMerger
from ik_node.control.late_inputs import late_conditions
from ik_node.control.status import DIRECTION, REACH, StatusReporter
from ik_node.control.step_timer import StepTimer
from ik_node.control.velocity_controller import ControlOutput, VelocityController
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Level, Mode, Status
from ik_node.targets.arbiter import TargetArbiter


def report_step(
    status: StatusReporter,
    now: Instant,
    output: ControlOutput,
    law: VelocityController,
    targets: TargetArbiter,
    timer: StepTimer,
    joint_states: JointStateMerger,
) -> None:
    """Sets mode, notes and conditions of the status after a control step with the result ``output``."""
    conditions = [*law.conditions(output), *targets.warnings]
    conditions += late_conditions(timer, joint_states, output.held_since_ns, targets.gap_ns)
    for subject, text in (("limits", ""), (REACH, targets.target_note), (DIRECTION, law.off_direction.text)):
        status.note(subject, text)
    status.set_conditions(conditions, now)
    mode = Mode.HOLDING if targets.ended else Mode.TRACKING
    status.set(Status(Level.OK, mode, targets.reason_when(targets.ended)))

"""The table from topic to decoder to controller method: a new kind of call is one line here and in ``CallKind``.

The node and the replay both make their calls through it. Topic, message type and decoder of the calls that take a
message come from :mod:`ik_node.recording.input_table`, which reading a recording needs as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ik_node.control.controller import Controller
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Step
from ik_node.messages.decode import decode_string
from ik_node.messages.step_codec import CallKind
from ik_node.recording.input_table import INPUTS, Input


class TableEntry(NamedTuple):
    """How one kind of call is made."""

    call: Callable[[Controller, Any, Instant], Step | None]
    """Takes the argument that ``decode`` returns; raises IkNodeError when the controller refuses it."""
    input: Input | None = None
    """Topic of the message that the call takes; None for calls without a message."""


CALL_TABLE: Mapping[CallKind, TableEntry] = {
    CallKind.ON_JOINT_STATE: TableEntry(Controller.on_joint_state, INPUTS[CallKind.ON_JOINT_STATE]),
    CallKind.ON_TARGET_POSE: TableEntry(Controller.on_target_pose, INPUTS[CallKind.ON_TARGET_POSE]),
    CallKind.ON_TARGET_PATH: TableEntry(Controller.on_target_path, INPUTS[CallKind.ON_TARGET_PATH]),
    CallKind.ON_TARGET_TRAJECTORY: TableEntry(Controller.on_target_trajectory, INPUTS[CallKind.ON_TARGET_TRAJECTORY]),
    CallKind.ON_TARGET_TWIST: TableEntry(Controller.on_target_twist, INPUTS[CallKind.ON_TARGET_TWIST]),
    CallKind.ON_OBSTACLES: TableEntry(Controller.on_obstacles, INPUTS[CallKind.ON_OBSTACLES]),
    # Calls with a text as argument:
    CallKind.ON_LISTENERS: TableEntry(lambda controller, count, now: controller.on_listeners(int(count), now)),
    CallKind.ON_PUBLISHERS: TableEntry(Controller.on_publishers),
    CallKind.ON_TRANSFORM: TableEntry(Controller.on_transform),
    CallKind.ON_INPUT_NOTE: TableEntry(Controller.on_input_note),
    CallKind.ON_METHOD_FAULT: TableEntry(lambda controller, reason, now: controller.method.fail(reason)),
    CallKind.PAUSE: TableEntry(lambda controller, reason, now: controller.pause(now, reason)),
    # Settings as argument:
    CallKind.APPLY: TableEntry(lambda controller, settings, now: controller.apply(settings)),
    # No argument:
    CallKind.ON_CLOCK: TableEntry(lambda controller, argument, now: controller.on_clock(now)),
    CallKind.RESUME: TableEntry(lambda controller, argument, now: controller.resume()),
    CallKind.RESET: TableEntry(lambda controller, argument, now: controller.reset()),
}


def decode_argument(kind: CallKind, data: bytes) -> Any:
    """Argument of a call from its recorded message.

    Args:
        kind: Any kind but ``APPLY``, whose settings depend on the run.
        data: CDR bytes; empty for calls without an argument.

    Returns:
        A sample of :mod:`ik_node.interfaces.samples`, a text, or None.

    Raises:
        InputError: The bytes are no message of this kind.
    """
    entry = CALL_TABLE[kind].input
    if entry is not None:
        return entry.decode(data)
    return decode_string(data) if data else None

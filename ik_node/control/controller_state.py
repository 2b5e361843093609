"""The controller's whole memory as plain data: what a recording that starts in the middle of a run begins with.

A part that gets a memory of its own is one more field here, and one line each in ``Controller.state`` and ``restore``.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.collision.scene import Scene
from ik_node.control.following_error import FollowingErrorSnapshot
from ik_node.control.joint_states import JointState, JointStateSnapshot
from ik_node.control.state_machine import StateMachineSnapshot
from ik_node.control.status import StatusSnapshot
from ik_node.control.velocity_controller import VelocityControllerSnapshot
from ik_node.robot.frames import FramesSnapshot
from ik_node.targets.arbiter import TargetsSnapshot


class CycleSnapshot(NamedTuple):
    """What the controller itself remembers; its attributes of the same names."""

    targets_refused: int
    states_refused: int
    tick: int
    state: JointState | None
    interval_s: float
    due_ns: int
    last_tick_ns: int
    retry_ns: int
    listeners: int
    keep_targets: bool


class ControllerSnapshot(NamedTuple):
    """Everything that decides what a controller does next, beside its robot and its settings."""

    cycle: CycleSnapshot
    supervision: StateMachineSnapshot
    status: StatusSnapshot
    joint_states: JointStateSnapshot
    frames: FramesSnapshot
    targets: TargetsSnapshot
    follow: FollowingErrorSnapshot
    law: VelocityControllerSnapshot
    scene: Scene

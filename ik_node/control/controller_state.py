"""Snapshot of a controller: its complete internal state as plain data, the start of a recording in the middle of a run.

A new component with internal state adds one field here, and one line each to ``Controller.capture`` and ``restore``.
"""

from __future__ import annotations

from typing import NamedTuple

from ik_node.collision.scene import Scene
from ik_node.control.following_error import FollowingErrorSnapshot
from ik_node.control.joint_states import JointState, JointStateSnapshot
from ik_node.control.state_machine import StateMachineSnapshot
from ik_node.control.status import StatusSnapshot
from ik_node.control.step_timer import TimerSnapshot
from ik_node.control.velocity_controller import VelocityControllerSnapshot
from ik_node.robot.frames import FramesSnapshot
from ik_node.targets.arbiter_state import ArbiterSnapshot


class CycleSnapshot(NamedTuple):
    """Attributes of a :class:`~ik_node.control.controller.Controller`, without those of its components."""

    targets_refused: int
    states_refused: int
    tick: int
    state: JointState | None
    last_step_ns: int
    retry_ns: int
    subscribers: int
    keep_targets: bool


class ControllerSnapshot(NamedTuple):
    """Complete internal state of a controller; together with robot and settings it determines all further results."""

    cycle: CycleSnapshot
    timer: TimerSnapshot
    state_machine: StateMachineSnapshot
    status: StatusSnapshot
    joint_states: JointStateSnapshot
    frames: FramesSnapshot
    targets: ArbiterSnapshot
    following_error: FollowingErrorSnapshot
    velocity_controller: VelocityControllerSnapshot
    scene: Scene

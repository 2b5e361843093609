"""Sources of controller calls for a replay: a recording of this package, or an external bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from ik_node.control.controller import Controller
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import IkNodeError
from ik_node.interfaces.step import Step
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall, RecordedCalls, RecordedSnapshot, decode_snapshot
from ik_node.replay.call_table import CALL_TABLE, decode_argument
from ik_node.replay.recorded_methods import recorded_methods
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings
from ik_node.settings.schema import Value


class CallSource(Protocol):
    """:class:`RecordingSource` or :class:`ik_node.replay.external_bag.ExternalBag`."""

    @property
    def initial_settings(self) -> Settings:
        """Settings at the start."""

    def robot(self) -> Robot:
        """A new robot of the run."""

    def controller(self, settings: Settings | None = None) -> Controller:
        """A new controller in the state at the start of the run; default: with the settings of the start."""

    def entries(self) -> Iterator[RecordedCall | RecordedSnapshot]:
        """Calls and snapshots in recorded order."""

    def settings(self, recorded: RecordedCall) -> Settings:
        """All settings after a call of kind ``APPLY``."""


class RecordingSource(RecordedCalls):
    """A recording with the means to construct its robot and controller."""

    def robot(self) -> Robot:
        """A new robot of the run; raises RobotError when the recorded URDF cannot be read."""
        setup, prefix = self.head.setup, self.head.settings.arm.joint_prefix
        return Robot(self.head.urdf, setup["base_frame"], setup["tip_frame"], tuple(setup["joints"]), prefix)

    def controller(self, settings: Settings | None = None) -> Controller:
        """A controller in the recorded state at the start of the run.

        Args:
            settings: Default: those at the start of the recording.

        Raises:
            RecordingError: The recorded snapshot is that of another version.
            SettingsError: ``settings`` name an own method that is neither recorded nor here.
        """
        settings = settings or self.head.settings
        snapshot, robot = self.head.snapshot, self.robot()
        methods = recorded_methods(robot, settings, self.head.setup["methods"])
        if snapshot is None:
            return Controller(robot, settings, methods)
        # The snapshot contains the obstacles; their scene file may not exist here.
        controller = Controller(robot, settings.with_values({"obstacles.scene": ""}), methods)
        controller.restore(decode_snapshot(snapshot, ControllerSnapshot))
        return controller


def calls(source: CallSource) -> Iterator[RecordedCall]:
    """The calls without the snapshots."""
    return (entry for entry in source.entries() if isinstance(entry, RecordedCall))


def argument_of(source: CallSource, recorded: RecordedCall, changes: Mapping[str, Value]) -> Any:
    """Argument of a recorded call; ``changes`` override the parameters of an ``APPLY`` call.

    Raises InputError when the recorded message is no message of its type.
    """
    if recorded.call.kind is CallKind.APPLY:
        return source.settings(recorded).with_values(changes)
    return decode_argument(recorded.call.kind, recorded.data)


def make_recorded_call(
    controller: Controller, source: CallSource, recorded: RecordedCall, changes: Mapping[str, Value] | None = None
) -> Step | None:
    """Makes a recorded call.

    Args:
        controller: Controller to call.
        source: Source of the call.
        recorded: The call.
        changes: Parameters that override those of an ``APPLY`` call.

    Returns:
        The Step, or None when the call made none or its argument was refused.
    """
    try:
        argument = argument_of(source, recorded, changes or {})
        return CALL_TABLE[recorded.call.kind].call(controller, argument, recorded.call.now)
    except IkNodeError:  # refused, as in the recorded run
        return None

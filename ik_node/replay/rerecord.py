"""Records a simulated run, so that the tools for recordings can be applied to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ik_node.messages.step_outputs import StepOutputs
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.replay.call_source import CallSource, calls
from ik_node.replay.closed_loop import SimulatedRun, close_loop
from ik_node.replay.recorded_controller import RecordedController
from ik_node.robot.simulated_arm import ArmModel
from ik_node.settings.schema import Value

NODE = "/ik_node"
OPTIONS = RecorderOptions(queue_mb=4096.0)
"""The simulation may be faster than the disk; a large queue avoids leaving messages out."""


def record_simulation(
    source: CallSource,
    changes: Mapping[str, Value],
    directory: Path,
    model: ArmModel | None = None,
    timer_ns: Callable[[], int] | None = None,
) -> SimulatedRun:
    """Simulates a run as :func:`ik_node.replay.closed_loop.simulate` does and records it.

    Args:
        source: Recorded calls.
        changes: Parameter -> value.
        directory: New folder.
        model: Lag and delay of the simulated arm; default: ideal.
        timer_ns: Clock that measures the computing time of a Step, ns; default: it is not measured.

    Returns:
        The Steps of the run.

    Raises:
        RecordingError: The folder exists or cannot be written, or the recording lacks joint states.
        SettingsError: A change is invalid.
    """
    controller = source.controller(source.initial_settings.with_values(changes))
    robot = controller.robot
    outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)
    recorded = RecordedController(controller, outputs.messages, timer_ns=timer_ns)
    recording = recorded.start(directory, NODE, next(calls(source)).call.now, options=OPTIONS)
    try:
        return close_loop(recorded, source, changes, model)
    finally:
        recording.close()

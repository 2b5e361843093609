"""A simulated run as a recording of its own, for the tools that look at recordings."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ik_node.messages import encode
from ik_node.messages.decode import decode_string
from ik_node.messages.encode import Outgoing, StepOutputs
from ik_node.recording.input_table import INPUTS, SETTINGS_CALLS, TEXT_CALLS
from ik_node.recording.mcap.writer import RecorderOptions
from ik_node.recording.run_recorder import RunRecording, RunSetup
from ik_node.replay.call_source import Source, calls
from ik_node.replay.closed_loop import Simulated, Told, simulate
from ik_node.settings.groups import Value

NODE = "/ik_node"
OPTIONS = RecorderOptions(queue_mb=4096.0)
"""Faster than real time the disk may fall behind; nothing is to be left out for that."""


def record_simulation(source: Source, changes: Mapping[str, Value], directory: Path) -> Simulated:
    """Simulates as :func:`ik_node.replay.closed_loop.simulate` does and records it to ``directory``.

    Raises RecordingError when the folder exists or cannot be written, and as that function does.
    """
    settings = source.begins_with.with_values(changes)
    controller = source.controller(settings)
    robot = controller.robot
    begin = next(calls(source)).call.now
    setup = RunSetup(NODE, settings.arm.robot, robot, settings, {}, controller.capture(), controller.geometry)
    recording = RunRecording(directory, setup, begin, OPTIONS)
    outputs = StepOutputs(robot.joints, robot.base_frame, robot.tip_frame)

    def record(told: Told) -> None:
        kind, _, now = told.event.call
        if kind in SETTINGS_CALLS:
            recording.applied(source.settings(told.event).with_values(changes), now)
        elif kind in TEXT_CALLS:
            recording.called(kind, now, text=decode_string(told.event.data))
        elif kind in INPUTS:
            data = told.event.data
            if told.sample is not None and len(told.sample.names) == len(told.sample.position):
                data = encode.encode_joint_state(told.sample.names, told.sample.stamp_ns, told.sample.position)
            recording.called(kind, now, recording.received(INPUTS[kind].name, data, now))
        else:
            recording.called(kind, now)
        if told.step is not None:
            command = Outgoing(encode.COMMANDS, outputs.command(told.step))
            recording.sent(told.step, [command, *outputs.others(told.step)])

    try:
        return simulate(source, changes, record)
    finally:
        recording.close()

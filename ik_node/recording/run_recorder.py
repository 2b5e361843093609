"""Writes a run of the controller: what came in, every call in its order, every Step, what went out, and of what.

Topics of a recording, beside the node's own inputs and outputs under their ROS names (``<node>`` is the node's full
name):

====================== ==================================== ==========================================================
``<node>/setup``       std_msgs/String, latched             JSON: robot, joints, frames, limits, versions, topics
``/robot_description`` std_msgs/String, latched             URDF
``<node>/parameters``  rcl_interfaces/ParameterEvent,       every parameter at the start and after each change
                       latched
``<node>/calls``       std_msgs/Int64MultiArray             each call of the controller
``<node>/calls/texts`` std_msgs/String                      texts that calls took (the reason of a pause)
``<node>/state``       std_msgs/String, latched             JSON: what the controller remembered at the start, and where
                                                            a file begins
``<node>/step``        std_msgs/Float64MultiArray           each Step, bit for bit
``<node>/step/texts``  diagnostic_msgs/DiagnosticStatus,    status and binding limits of the Steps that follow
                       latched
====================== ==================================== ==========================================================

How calls and Steps are packed: :mod:`ik_node.messages.step_codec`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

import ik_node
from ik_node.control.controller_state import ControllerSnapshot
from ik_node.errors import RecordingError
from ik_node.interfaces.clock import Instant
from ik_node.interfaces.step import Step
from ik_node.math.types import Array
from ik_node.messages.encode import STATUS, TYPES, Outgoing, encode_string
from ik_node.messages.parameters import PARAMETERS_TYPE, Parameters, encode_parameters
from ik_node.messages.step_codec import (
    CALL_TYPE,
    STEP_TYPE,
    TEXTS_TYPE,
    Call,
    CallKind,
    StepEncoder,
    encode_call,
)
from ik_node.recording.environment import versions
from ik_node.recording.input_table import INPUT_TYPES, JOINT_STATES
from ik_node.recording.json_codec import to_json
from ik_node.recording.mcap.metadata import Qos
from ik_node.recording.mcap.writer import Recorder, RecorderOptions
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.settings.groups import RecordingSettings, Settings

FORMAT = 1
"""Version of the topics and their packing; raised when a reader of the old one would misread the new."""
SETUP = "setup"
PARAMETERS = "parameters"
CALLS = "calls"
CALL_TEXTS = "calls/texts"
STATE = "state"
STEP = "step"
STEP_TEXTS = "step/texts"
ROBOT_DESCRIPTION = "/robot_description"
STRING_TYPE = "std_msgs/msg/String"

_LATCHED = Qos(depth=1, latched=True)
_WITHOUT = ("robot_description",)  # has a topic of its own


class RunSetup(NamedTuple):
    """What a recording says of the run as a whole."""

    node: str
    """Full name of the node: ``/ik_node``."""
    robot_name: str
    robot: Robot
    settings: Settings
    topics: Mapping[str, str]
    """Inputs (:data:`INPUT_TYPES`) and outputs (:data:`ik_node.messages.TYPES`) -> ROS name, where it is not the usual
    one."""
    state: ControllerSnapshot | None = None
    """What the controller remembers when the recording begins; None: it has not been called yet."""
    geometry: str = ""
    """A digest of what distances are measured with."""


class _Put(NamedTuple):
    """What became of a message."""

    sequence: int
    written: bool


class RunRecording:
    """A run being recorded; every method returns at once and raises nothing."""

    def __init__(self, directory: Path, setup: RunSetup, now: Instant, options: RecorderOptions | None = None) -> None:
        """Creates ``directory``; RecordingError when it exists or cannot be made."""
        self.node = setup.node.rstrip("/")
        self._setup = setup
        self._settings = setup.settings
        self._recorder = self._make_recorder(
            directory, options, {"ik_node": ik_node.__version__, "format": str(FORMAT)}
        )
        self._steps = StepEncoder(self.node, setup.robot.n)
        own = {SETUP: STRING_TYPE, PARAMETERS: PARAMETERS_TYPE, STATE: STRING_TYPE, STEP_TEXTS: TEXTS_TYPE}
        self._channels = {
            ROBOT_DESCRIPTION: self._recorder.channel(ROBOT_DESCRIPTION, STRING_TYPE, _LATCHED),
            **{name: self._own_channel(name, kind, _LATCHED) for name, kind in own.items()},
            **{name: self._own_channel(name, kind) for name, kind in ((CALLS, CALL_TYPE), (STEP, STEP_TYPE))},
            CALL_TEXTS: self._own_channel(CALL_TEXTS, STRING_TYPE),
        }
        self._inputs = {name: self._recorder.channel(self._topic(name), kind) for name, kind in INPUT_TYPES.items()}
        self._outputs = {
            name: self._recorder.channel(self._topic(name), kind, _LATCHED if name == STATUS else None)
            for name, kind in TYPES.items()
        }
        self._sequences: dict[int, int] = {}
        self._dropped_before_call = self._dropped_before_state = 0
        self._defect = ""
        self._put(self._channels[ROBOT_DESCRIPTION], encode_string(setup.robot.urdf), now.ros_ns)
        self._put(self._channels[SETUP], encode_string(setup_json(setup, self._input_topics())), now.ros_ns)
        self._put_parameters({}, now)
        if setup.state is not None:
            self._put_state(setup.state, now)

    def _make_recorder(self, directory: Path, options: RecorderOptions | None, custom: dict[str, str]) -> Recorder:
        return Recorder(directory, options, custom)

    # --- what happens ---

    def received(self, name: str, data: bytes, now: Instant, publish_time_ns: int = 0) -> int:
        """A message on an input (a key of :data:`INPUT_TYPES`), as it came; returns its sequence, for :meth:`called`.

        ``publish_time_ns`` is when its source sent it, 0 when not known.
        """
        return self._put(self._inputs[name], data, now.ros_ns, publish_time_ns).sequence

    def called(self, kind: CallKind, now: Instant, sequence: int = -1, text: str = "") -> None:
        """A call of the controller, with the sequence of the message or the text that it took.

        To be told after the call was made, and before the Step that came of it.
        """
        if text:
            sequence = self._put(self._channels[CALL_TEXTS], encode_string(text), now.ros_ns).sequence
        self._put(self._channels[CALLS], encode_call(Call(kind, sequence, now)), now.ros_ns)

    def applied(self, settings: Settings, now: Instant) -> None:
        """The controller took over other settings: the call and the values."""
        before, self._settings = self._settings.flat(), settings
        changed = {name for name, value in settings.flat().items() if before[name] != value}
        self.called(CallKind.APPLY, now, self._put_parameters(changed, now))

    def sent(self, step: Step, outgoing: Iterable[Outgoing]) -> None:
        """A Step and the messages that said it."""
        stamp_ns = step.now.ros_ns
        try:
            texts, numbers = self._steps.encode(step)
        except RecordingError as error:  # a defect, but the arm goes on
            self._defect = f"recording '{self.directory}' lacks Steps: {error}"
            return
        if texts is None or self._put(self._channels[STEP_TEXTS], texts, stamp_ns).written:
            self._put(self._channels[STEP], numbers, stamp_ns)
        else:  # a Step without its texts could not be read
            self._steps.repeat_texts()
        for topic, data in outgoing:
            self._put(self._outputs[topic], data, stamp_ns)

    def said(self, message: Outgoing, now: Instant) -> None:
        """A message that went out beside the Steps: status, diagnostics."""
        self._put(self._outputs[message.topic], message.data, now.ros_ns)

    def between_calls(self, state: Callable[[], ControllerSnapshot], now: Instant) -> None:
        """To be told after each call and what it led to: here a new file can begin, with the controller's state.

        The state is written too once nothing has to be left out any more, so that a replay can go on from there.
        """
        dropped = self._recorder.dropped
        if self._recorder.split_due:
            if self._put_state(state(), now):
                self._recorder.split()
        elif self._dropped_before_state != dropped == self._dropped_before_call:
            self._dropped_before_state = dropped
            self._put_state(state(), now)
        self._dropped_before_call = dropped

    def end(self) -> None:
        """Stops recording and returns at once, for a control loop that goes on; the writer does the rest."""
        self._recorder.end()

    def close(self) -> None:
        """Stops recording and waits until it is whole; harmless when called again."""
        self._recorder.close()

    @property
    def directory(self) -> Path:
        """Where it lies."""
        return self._recorder.directory

    @property
    def dropped(self) -> int:
        """Messages left out because the disk could not keep up."""
        return self._recorder.dropped

    @property
    def error(self) -> str:
        """Why the recording has ended before :meth:`close` or is not whole, or empty."""
        return self._recorder.error or self._defect

    # --- channels ---

    def _put(self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int = 0) -> _Put:
        sequence = self._sequences.get(channel, 0)
        self._sequences[channel] = sequence + 1
        return _Put(sequence, self._recorder.write(channel, data, log_time_ns, publish_time_ns, sequence))

    def _put_parameters(self, changed: Iterable[str], now: Instant) -> int:
        values = {name: value for name, value in self._settings.flat().items() if name not in _WITHOUT}
        parameters = Parameters(values, {name: values[name] for name in sorted(changed) if name in values})
        data = encode_parameters(self.node, now.ros_ns, parameters)
        return self._put(self._channels[PARAMETERS], data, now.ros_ns).sequence

    def _put_state(self, state: ControllerSnapshot, now: Instant) -> bool:
        return self._put(self._channels[STATE], encode_string(to_json(state)), now.ros_ns).written

    def _own_channel(self, name: str, type_name: str, qos: Qos | None = None) -> int:
        return self._recorder.channel(f"{self.node}/{name}", type_name, qos)

    def _topic(self, name: str) -> str:
        usual = {JOINT_STATES: "/joint_states"}.get(name, name if name.startswith("/") else f"{self.node}/{name}")
        return self._setup.topics.get(name, usual)

    def _input_topics(self) -> dict[str, str]:
        return {name: self._topic(name) for name in INPUT_TYPES}


def recorder_options(settings: RecordingSettings) -> RecorderOptions:
    """The options that the parameters ask for."""
    return RecorderOptions(
        compression=settings.compression,
        flush_period_s=settings.flush_period_s,
        queue_mb=settings.queue_mb,
        max_part_mb=settings.max_part_mb,
        max_part_s=settings.max_part_s,
    )


def setup_json(setup: RunSetup, input_topics: Mapping[str, str]) -> str:
    """The text of the topic ``setup``; limits that there are not are null."""
    robot, settings = setup.robot, setup.settings
    limits = motion_limits(robot, settings.limits, settings.control.rate_hz)
    content = {
        "format": FORMAT,
        "node": setup.node,
        "robot": setup.robot_name,
        "base_frame": robot.base_frame,
        "tip_frame": robot.tip_frame,
        "joints": list(robot.joints),
        "limits": {
            "lower": _finite_or_null(limits.lower),
            "upper": _finite_or_null(limits.upper),
            "velocity": _finite_or_null(limits.velocity),
            "acceleration": _finite_or_null(limits.acceleration),
        },
        "inputs": dict(input_topics),
        "call_kinds": {kind.name.lower(): int(kind) for kind in CallKind},
        "urdf_sha256": hashlib.sha256(robot.urdf.encode()).hexdigest(),
        "geometry": setup.geometry,
        "versions": dict(versions()),
    }
    return json.dumps(content, indent=1)


def _finite_or_null(values: Array) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]

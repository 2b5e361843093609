"""Writes a run: input messages, controller calls in their order, Steps, outputs, and a description of the run.

Topics of a recording besides the node's inputs and outputs, which keep their ROS names (``<node>`` is the full name of
the node):

====================== ==================================== ==========================================================
``<node>/setup``       std_msgs/String, latched             JSON: robot, joints, frames, limits, versions, topics
``/robot_description`` std_msgs/String, latched             URDF
``<node>/parameters``  rcl_interfaces/ParameterEvent,       all parameters at the start and after each change
                       latched
``<node>/calls``       std_msgs/Int64MultiArray             controller calls
``<node>/calls/texts`` std_msgs/String                      text arguments of calls, for example the reason of a pause
``<node>/snapshot``    std_msgs/String, latched             JSON: state of the controller at the start of the run and of
                                                            each file
``<node>/step``        std_msgs/Float64MultiArray           Steps, bit for bit; publish time minus log time: computing
                                                            time
``<node>/step/texts``  diagnostic_msgs/DiagnosticStatus,    text fields of the Steps that follow
                       latched
====================== ==================================== ==========================================================

Encoding of calls and Steps: :mod:`ik_node.messages.step_codec`.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

import ik_node
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
from ik_node.settings.groups import Settings
from ik_node.settings.recording import RecordingSettings

FORMAT = 2
"""Version of the topics and their encoding; incremented when older readers would misread a recording."""
SETUP = "setup"
PARAMETERS = "parameters"
CALLS = "calls"
CALL_TEXTS = "calls/texts"
SNAPSHOT = "snapshot"
STEP = "step"
STEP_TEXTS = "step/texts"
ROBOT_DESCRIPTION = "/robot_description"
STRING_TYPE = "std_msgs/msg/String"

_LATCHED = Qos(depth=1, latched=True)
_WITHOUT = ("robot_description",)  # has a topic of its own


class RunSetup(NamedTuple):
    """Description of a run; :func:`ik_node.replay.recorded_controller.run_setup` makes it for a controller."""

    node: str
    """Full name of the node, for example ``/ik_node``."""
    robot_name: str
    urdf: str
    joints: tuple[str, ...]
    base_frame: str
    tip_frame: str
    limits: Mapping[str, Array]
    """``lower``, ``upper``, ``velocity`` and ``acceleration`` limits in force, (n,), in rad and s (m and s)."""
    settings: Settings
    topics: Mapping[str, str]
    """Inputs (:data:`INPUT_TYPES`) and outputs (:data:`ik_node.messages.encode.TYPES`) -> ROS name, where it is not the
    default."""
    snapshot: object = None
    """State of the controller at the start, as plain data; None when it has not been called."""
    geometry: str = ""
    """Digest of the collision geometry."""
    methods: Mapping[str, str] = MappingProxyType({})
    """Own methods: name -> digest of the source."""


class _Put(NamedTuple):
    """Result of writing a message."""

    sequence: int
    written: bool


class RunRecording:
    """A run being recorded; after construction its methods do not wait and do not raise."""

    def __init__(self, directory: Path, setup: RunSetup, now: Instant, options: RecorderOptions | None = None) -> None:
        """Creates ``directory``; raises RecordingError when it exists or cannot be created."""
        self.node = setup.node.rstrip("/")
        self._setup = setup
        self._settings = setup.settings
        self._recorder = self._make_recorder(
            directory, options, {"ik_node": ik_node.__version__, "format": str(FORMAT)}
        )
        self._steps = StepEncoder(self.node, len(setup.joints))
        own = {SETUP: STRING_TYPE, PARAMETERS: PARAMETERS_TYPE, SNAPSHOT: STRING_TYPE, STEP_TEXTS: TEXTS_TYPE}
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
        self._dropped_before_call = self._dropped_before_snapshot = 0
        self._defect = ""
        self._put(self._channels[ROBOT_DESCRIPTION], encode_string(setup.urdf), now.ros_ns)
        self._put(self._channels[SETUP], encode_string(setup_json(setup, self._input_topics())), now.ros_ns)
        self._put_parameters({}, now)
        if setup.snapshot is not None:
            self._put_snapshot(setup.snapshot, now)

    def _make_recorder(self, directory: Path, options: RecorderOptions | None, custom: dict[str, str]) -> Recorder:
        return Recorder(directory, options, custom)

    # --- events ---

    def record_input(self, name: str, data: bytes, now: Instant, publish_time_ns: int = 0) -> int:
        """Records an input message.

        Args:
            name: Key of :data:`INPUT_TYPES`.
            data: CDR bytes as received.
            now: Time of reception.
            publish_time_ns: ROS time at which it was sent; 0 when unknown.

        Returns:
            Sequence number of the message on its topic, for :meth:`record_call`.
        """
        return self._put(self._inputs[name], data, now.ros_ns, publish_time_ns).sequence

    def record_call(self, kind: CallKind, now: Instant, sequence: int = -1, text: str | None = None) -> None:
        """Records a controller call, after it was made and before the Step that it returned.

        Args:
            kind: The called method.
            now: Time of the call.
            sequence: Of the message that was passed in; -1 for none.
            text: Text argument; None for none.
        """
        if text is not None:
            sequence = self._put(self._channels[CALL_TEXTS], encode_string(text), now.ros_ns).sequence
        self._put(self._channels[CALLS], encode_call(Call(kind, sequence, now)), now.ros_ns)

    def record_settings(self, settings: Settings, now: Instant) -> None:
        """Records a call of kind ``APPLY`` with its settings."""
        before, self._settings = self._settings.flat(), settings
        changed = {name for name, value in settings.flat().items() if before[name] != value}
        self.record_call(CallKind.APPLY, now, self._put_parameters(changed, now))

    def record_step(self, step: Step, outgoing: Iterable[Outgoing], computing_ns: int = 0) -> None:
        """Records a Step and the output messages that were published for it.

        Args:
            step: The Step.
            outgoing: The messages.
            computing_ns: Time from the call of the controller until the messages were published; 0 when not measured.
        """
        stamp_ns = step.now.ros_ns
        try:
            texts, numbers = self._steps.encode(step)
        except RecordingError as error:  # a defect; the control loop continues
            self._defect = f"recording '{self.directory}' lacks Steps: {error}"
            return
        if texts is None or self._put(self._channels[STEP_TEXTS], texts, stamp_ns).written:
            self._put(self._channels[STEP], numbers, stamp_ns, stamp_ns + computing_ns)
        else:  # a Step without its texts could not be read
            self._steps.repeat_texts()
        for topic, data in outgoing:
            self._put(self._outputs[topic], data, stamp_ns)

    def record_output(self, message: Outgoing, now: Instant) -> None:
        """Records an output message that belongs to no Step: status, diagnostics."""
        self._put(self._outputs[message.topic], message.data, now.ros_ns)

    def after_call(self, capture: Callable[[], object], now: Instant) -> None:
        """Starts a new file when one is due; to be called after each call and its Step were recorded.

        A snapshot is also written when messages were left out and the writer has caught up, so that a replay can resume
        there.

        Args:
            capture: Returns the state of the controller as plain data.
            now: Time of the call.
        """
        dropped = self._recorder.dropped
        if self._recorder.split_due:
            if self._put_snapshot(capture(), now):
                self._recorder.split()
        elif self._dropped_before_snapshot != dropped == self._dropped_before_call:
            self._dropped_before_snapshot = dropped
            self._put_snapshot(capture(), now)
        self._dropped_before_call = dropped

    def write_pending(self) -> None:
        """Writes what has gathered, where no thread does it (:attr:`RecorderOptions.own_thread`)."""
        self._recorder.write_pending()

    def end(self) -> None:
        """Stops recording without waiting; the writer finishes in the background."""
        self._recorder.end()

    def close(self) -> None:
        """Stops recording and waits until the files are complete; may be called repeatedly."""
        self._recorder.close()

    @property
    def directory(self) -> Path:
        """Folder of the recording."""
        return self._recorder.directory

    @property
    def dropped(self) -> int:
        """Number of messages left out because the disk was too slow."""
        return self._recorder.dropped

    @property
    def error(self) -> str:
        """Why the recording ended early or is incomplete; empty for none."""
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

    def _put_snapshot(self, snapshot: object, now: Instant) -> bool:
        return self._put(self._channels[SNAPSHOT], encode_string(to_json(snapshot)), now.ros_ns).written

    def _own_channel(self, name: str, type_name: str, qos: Qos | None = None) -> int:
        return self._recorder.channel(f"{self.node}/{name}", type_name, qos)

    def _topic(self, name: str) -> str:
        usual = {JOINT_STATES: "/joint_states"}.get(name, name if name.startswith("/") else f"{self.node}/{name}")
        return self._setup.topics.get(name, usual)

    def _input_topics(self) -> dict[str, str]:
        return {name: self._topic(name) for name in INPUT_TYPES}


def recorder_options(settings: RecordingSettings) -> RecorderOptions:
    """Writer options from the parameters."""
    return RecorderOptions(
        compression=settings.compression,
        max_part_mb=settings.max_part_mb,
        max_part_s=settings.max_part_s,
    )


def setup_json(setup: RunSetup, input_topics: Mapping[str, str]) -> str:
    """The text of the topic ``setup``; infinite limits are null."""
    content = {
        "format": FORMAT,
        "node": setup.node,
        "robot": setup.robot_name,
        "base_frame": setup.base_frame,
        "tip_frame": setup.tip_frame,
        "joints": list(setup.joints),
        "limits": {name: _finite_or_null(values) for name, values in setup.limits.items()},
        "inputs": dict(input_topics),
        "call_kinds": {kind.name.lower(): int(kind) for kind in CallKind},
        "urdf_sha256": hashlib.sha256(setup.urdf.encode()).hexdigest(),
        "geometry": setup.geometry,
        "methods": dict(setup.methods),
        "versions": dict(versions()),
    }
    return json.dumps(content, indent=1)


def _finite_or_null(values: Array) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]

"""Reads a recording into a :class:`~ik_node.recording.run.Run`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import TEXT_FIELDS
from ik_node.math.types import Array
from ik_node.messages.decode import decode_string, is_simulated
from ik_node.messages.decode_targets import decode_pose
from ik_node.messages.parameters import decode_parameters
from ik_node.messages.step_codec import (
    FIELDS,
    MAX_COUNT,
    Call,
    CallKind,
    TextRecord,
    decode_call,
    decode_texts,
    read_layout,
    shapes,
)
from ik_node.recording.call_log import open_recording, read_setup
from ik_node.recording.input_table import JOINT_STATES, TARGET_POSE
from ik_node.recording.mcap.file import MAX_TIME_NS
from ik_node.recording.mcap.reader import RecordedMessage, Recording
from ik_node.recording.run import CallTimes, RecordedTargets, Run, StatusChange
from ik_node.recording.run_recorder import (
    CALLS,
    PARAMETERS,
    ROBOT_DESCRIPTION,
    SETUP,
    STEP,
    STEP_TEXTS,
)


class _Messages(NamedTuple):
    """Messages of a run, collected in one pass over the recording."""

    setup: dict[str, Any]
    urdf: str
    parameters: list[RecordedMessage]
    calls: list[Call]
    steps: list[bytes]
    computing_ns: list[int]
    """Publish time minus log time of each Step."""
    texts: list[TextRecord]
    targets: list[RecordedMessage]
    simulated: bool = False


def load_run(path: str | Path, node: str = "") -> Run:
    """Reads a recorded run.

    Args:
        path: Recording: a folder or one of its files, complete or cut off.
        node: Full name of the node; default: the only recorded one.

    Returns:
        The run as arrays over control steps.

    Raises:
        RecordingError: There is no recording, it is damaged, or it contains no run of that node; the message lists what
            it contains.
    """
    recording, name = open_recording(Path(path), node)
    messages = _collect(recording, name)
    if not messages.steps:
        raise RecordingError(f"'{path}' contains no control step of node '{name}'")
    columns = _columns(messages.steps)
    if (n := columns["joint_position"].shape[1]) != len(messages.setup["joints"]):
        raise RecordingError(f"'{path}' has Steps of {n} joints, but the run has {len(messages.setup['joints'])}")
    clock = _Clock(columns)
    texts = _texts(columns["texts"][:, 0], messages.texts)
    limits = messages.setup["limits"]
    first, *changes = [
        (message, decode_parameters(message.data)) for message in _without_repetitions(messages.parameters)
    ]
    return Run(
        robot=str(messages.setup["robot"]),
        urdf=messages.urdf,
        joints=tuple(messages.setup["joints"]),
        lower=_limit(limits["lower"], -np.inf),
        upper=_limit(limits["upper"], np.inf),
        velocity_limits=_limit(limits["velocity"], np.inf),
        base_frame=str(messages.setup["base_frame"]),
        tip_frame=str(messages.setup["tip_frame"]),
        settings=first[1].values,
        setting_changes=tuple(
            (clock.of_ros(message.log_time_ns), parameters.changed) for message, parameters in changes
        ),
        versions=dict(messages.setup["versions"]),
        tick=_whole(columns["tick"][:, 0]),
        times_s=(clock.now_ns - clock.start.monotonic_ns) / NS,
        ros_ns=clock.ros_ns,
        state_times_s=(clock.state_ns - clock.start.monotonic_ns) / NS,
        state_ros_ns=clock.ros_ns - (clock.now_ns - clock.state_ns),
        computing_s=np.array([time_ns / NS if time_ns else np.nan for time_ns in messages.computing_ns]),
        simulated=messages.simulated,
        columns={field.name: columns[field.name] for field in FIELDS},
        texts=texts,
        status_changes=_changes(clock.now_ns, texts["status"], clock.start.monotonic_ns),
        targets=_targets(messages, clock),
        calls=_call_times(messages.calls, clock),
        dropped=recording.dropped,
        complete=recording.complete,
    )


def _collect(recording: Recording, node: str) -> _Messages:
    setups: list[dict[str, Any]] = []
    messages = _Messages({}, "", [], [], [], [], [], [])
    urdf, simulated = "", False
    states_topic = ""
    wanted = {f"{node}/{name}": name for name in (SETUP, PARAMETERS, CALLS, STEP, STEP_TEXTS)}
    wanted[ROBOT_DESCRIPTION] = ROBOT_DESCRIPTION
    for message in recording.messages():
        name = wanted.get(message.topic)
        try:
            if name == STEP:
                messages.steps.append(message.data)
                messages.computing_ns.append(message.publish_time_ns - message.log_time_ns)
            elif name == CALLS:
                messages.calls.append(decode_call(message.data))
            elif name == STEP_TEXTS:
                messages.texts.append(decode_texts(message.data))
            elif name == PARAMETERS:
                messages.parameters.append(message)
            elif name == ROBOT_DESCRIPTION:
                urdf = decode_string(message.data)
            elif name == SETUP:
                setups.append(read_setup(decode_string(message.data)))
            elif setups and message.topic == setups[0]["inputs"].get(TARGET_POSE):
                messages.targets.append(message)
            elif setups and not states_topic and message.topic == setups[0]["inputs"].get(JOINT_STATES):
                states_topic, simulated = message.topic, is_simulated(message.data)
        except InputError as error:
            raise RecordingError(f"'{recording.path}', topic {message.topic}: {error}") from error
    if not setups or not messages.parameters:
        raise RecordingError(f"'{recording.path}' lacks the start of the run of node '{node}'")
    return messages._replace(setup=setups[0], urdf=urdf, simulated=simulated)


def _columns(steps: list[bytes]) -> dict[str, Array]:
    """Slice label -> (k, *shape); counters, times and text numbers (k, size)."""
    prefix, slices = read_layout(steps[0])
    if not all(len(step) == len(steps[0]) and step.startswith(prefix) for step in steps):
        raise RecordingError("the Steps of a run have different layouts")
    begin = len(prefix)
    table = np.frombuffer(b"".join(step[begin:] for step in steps), "<f8").reshape(len(steps), -1)
    columns = {label: np.ascontiguousarray(table[:, place], dtype=np.float64) for label, place in slices.items()}
    reshaped = {name: columns[name].reshape(len(steps), *shape) for name, shape in shapes(slices).items()}
    return columns | reshaped


class _Clock:
    """Time axis of a run; t = 0 is its first control step."""

    def __init__(self, columns: dict[str, Array]) -> None:
        self.now_ns = _nanoseconds(columns["now_monotonic"])
        self.ros_ns = _nanoseconds(columns["now_ros"])
        self.state_ns = _nanoseconds(columns["state_time"])
        self.start = Instant(int(self.now_ns[0]), int(self.ros_ns[0]))

    def of(self, now: Instant) -> float:
        """Seconds since the first control step."""
        return (now.monotonic_ns - self.start.monotonic_ns) / NS

    def of_ros(self, ros_ns: int) -> float:
        """Seconds since the first control step, for a ROS time."""
        return (ros_ns - self.start.ros_ns) / NS


def _nanoseconds(parts: Array) -> NDArray[np.int64]:
    seconds, nanoseconds = _whole(parts).T
    if not (np.abs(seconds) < MAX_TIME_NS // NS).all():
        raise RecordingError("the time of a Step is not within 292 years of 0")
    return np.asarray(seconds * NS + nanoseconds)


def _whole(numbers: Array) -> NDArray[np.int64]:
    """Counters and parts of times, of any shape; raises RecordingError when one is none."""
    if not (np.abs(numbers) <= MAX_COUNT).all():
        raise RecordingError("a Step has a counter or a time that is not finite or too large")
    return numbers.astype(np.int64)


def _texts(numbers: Array, records: list[TextRecord]) -> dict[str, tuple[Any, ...]]:
    """Text field -> value per control step."""
    fields = {record.number: record.fields for record in records}
    used = _whole(numbers).tolist()
    missing = sorted(set(used) - set(fields))
    if missing:
        raise RecordingError(f"the recording lacks the text records {missing[:5]} of its control steps")
    values = zip(*(fields[number] for number in used), strict=True)
    return {field.name: value for field, value in zip(TEXT_FIELDS, values, strict=True)}


def _changes(now_ns: NDArray[np.int64], status: tuple[Any, ...], start_ns: int) -> tuple[StatusChange, ...]:
    first = [row for row in range(len(status)) if row == 0 or status[row] != status[row - 1]]
    return tuple(StatusChange((int(now_ns[row]) - start_ns) / NS, status[row]) for row in first)


def _without_repetitions(messages: list[RecordedMessage]) -> list[RecordedMessage]:
    """The messages without the repetitions in later files.

    The data are compared too: they have a stamp, and the sequence numbers may have been lost (all 0).
    """
    return list({(message.sequence, message.data): message for message in reversed(messages)}.values())[::-1]


def _targets(messages: _Messages, clock: _Clock) -> RecordedTargets:
    called = {call.sequence: call.now for call in messages.calls if call.kind is CallKind.ON_TARGET_POSE}
    if len({message.sequence for message in messages.targets}) < len(messages.targets):
        called = {}  # `ros2 bag convert` writes no sequence numbers (all 0); the times of recording remain
    samples = [decode_pose(message.data) for message in messages.targets]
    times = [
        clock.of(called[message.sequence]) if message.sequence in called else clock.of_ros(message.log_time_ns)
        for message in messages.targets
    ]
    return RecordedTargets(
        times_s=np.array(times, dtype=np.float64),
        received_ros_ns=np.array([message.log_time_ns for message in messages.targets], dtype=np.int64),
        stamp_ns=np.array([sample.stamp_ns for sample in samples], dtype=np.int64),
        position=np.array([sample.position for sample in samples]).reshape(-1, 3),
        quaternion_xyzw=np.array([sample.quaternion for sample in samples]).reshape(-1, 4),
        frame_ids=tuple(sample.frame_id for sample in samples),
    )


def _call_times(calls: list[Call], clock: _Clock) -> CallTimes:
    used = [call for call in calls if call.kind in (CallKind.ON_JOINT_STATE, CallKind.ON_CLOCK, CallKind.RESUME)]
    return CallTimes(
        np.array([clock.of(call.now) for call in used], dtype=np.float64),
        np.array([call.kind is CallKind.RESUME for call in used], dtype=np.bool_),
    )


def _limit(values: list[float | None], missing: float) -> Array:
    return np.array([missing if value is None else value for value in values])

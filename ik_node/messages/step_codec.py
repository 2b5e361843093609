"""The Step and the controller's calls as messages that open anywhere, and back again bit for bit.

Three channels of a recording, all of standard types:

``step`` (std_msgs/Float64MultiArray): one per tick. ``layout.dim`` names the slices of ``data`` one after the other
(label, and size in numbers); labels are the fields of :class:`ik_node.interfaces.step.Step`. A time is two numbers, whole seconds
and the nanoseconds beyond them, since one float64 does not hold the nanoseconds of an epoch; poses are row by row.
Status, names of binding limits and of the closest pair are text: the slice ``texts`` holds the number of the text
record that applies.

``step/texts`` (diagnostic_msgs/DiagnosticStatus): written before the first step it applies to. Level, message = reason,
and the values ``number``, ``mode``, one ``binding`` per limit that bound, and ``closest`` for each of the pair.

``calls`` (std_msgs/Int64MultiArray): every call of the controller, in order: kind, sequence of the input message on its
topic (-1 where there is none), monotonic ns, ROS ns.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Level, Mode, Status, Step
from ik_node.math.types import Array
from ik_node.messages.cdr import Template, blank, deserialize, make, serialize

STEP_TYPE = "std_msgs/msg/Float64MultiArray"
TEXTS_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"
CALL_TYPE = "std_msgs/msg/Int64MultiArray"

_HEAD = ("tick", "now_monotonic", "now_ros", "state_time", "texts")
_HEAD_SIZES = (1, 2, 2, 2, 1)
_head = struct.Struct("<8d")
_number = struct.Struct("<d")
_numbers = struct.Struct("<4d")
_call = struct.Struct("<4q")
POSES = ("pose_sb", "pose_sd")
"""Slices that are 4 by 4 matrices."""
NUMBERS = ("scale", "progress", "path_distance", "clearance")
"""Slices that are single numbers in a Step."""
ARRAYS = (
    "joint_position",
    "joint_velocity",
    "pose_sb",
    "pose_sd",
    "error_b",
    "feedforward_b",
    "twist_b",
    "lost_b",
    "multiplier_task",
    "multiplier_potential",
    "singular_values",
    "closest_points",
)
"""Fields of a Step that are arrays, in the order in which they stand in a message."""


class CallKind(IntEnum):
    """What was called; the names are those of the controller's methods."""

    ON_JOINT_STATE = 1
    ON_TARGET_POSE = 2
    ON_CLOCK = 3
    PAUSE = 4
    RESUME = 5
    RESET = 6
    APPLY = 7
    ON_OBSTACLES = 8
    ON_LISTENERS = 9
    ON_TARGET_PATH = 10
    ON_TARGET_TRAJECTORY = 11
    ON_TARGET_TWIST = 12
    ON_PUBLISHERS = 13
    ON_TRANSFORM = 14


_KINDS = {int(kind): kind for kind in CallKind}


class Call(NamedTuple):
    """One call of the controller."""

    kind: CallKind
    sequence: int
    """Of the message that was passed in, among those of its topic; -1 where the call takes none."""
    now: Instant


class StepMessages(NamedTuple):
    """What one Step adds to a recording."""

    texts: bytes | None
    """For the channel ``step/texts``, before ``step``; None when it is the same as at the last tick."""
    step: bytes


class StepEncoder:
    """Steps -> messages. Holds the last texts, so that they are written only when they change."""

    def __init__(self, name: str, n: int) -> None:
        """``name`` of the node, for people; ``n`` joints."""
        self._name = name
        self._prefix, size = _step_prefix(n)
        self._length = len(self._prefix) + size
        self._number = -1
        self._last: Words | None = None
        encode_texts(
            name, 0, Words(Status(Level.OK, Mode.WAITING, ""), (), ())
        )  # compiles the serialiser before the first tick

    def repeat_texts(self) -> None:
        """The last text record was lost: the next Step brings its own."""
        self._last = None

    def encode(self, step: Step) -> StepMessages:
        """The messages of ``step``."""
        texts, number, words = None, self._number, words_of(step)
        if words != self._last:
            number += 1
            texts = encode_texts(self._name, number, words)
        numbers = self.numbers(step, number)
        self._last, self._number = words, number
        return StepMessages(texts, numbers)

    def numbers(self, step: Step, text_number: int) -> bytes:
        """The message of ``step`` for the channel ``step``; its texts have this number."""
        now_s, now_ns = divmod(step.now.monotonic_ns, NS)
        ros_s, ros_ns = divmod(step.now.ros_ns, NS)
        state_s, state_ns = divmod(step.state_time_ns, NS)
        data = b"".join(
            (
                self._prefix,
                _head.pack(step.tick, now_s, now_ns, ros_s, ros_ns, state_s, state_ns, text_number),
                step.joint_position.tobytes(),
                step.joint_velocity.tobytes(),
                step.pose_sb.tobytes(),
                step.pose_sd.tobytes(),
                step.error_b.tobytes(),
                step.feedforward_b.tobytes(),
                step.twist_b.tobytes(),
                step.lost_b.tobytes(),
                step.multiplier_task.tobytes(),
                step.multiplier_potential.tobytes(),
                step.singular_values.tobytes(),
                step.closest_points.tobytes(),
                _numbers.pack(step.scale, step.progress, step.path_distance, step.clearance),
            )
        )
        if len(data) != self._length:
            raise RecordingError(f"Step message of {len(data)} bytes, expected {self._length}: other joints?")
        return data


class Words(NamedTuple):
    """What of a Step is text."""

    status: Status
    binding: tuple[str, ...]
    closest_pair: tuple[str, ...]


def words_of(step: Step) -> Words:
    """The texts of a Step."""
    return Words(step.status, step.binding, step.closest_pair)


class Texts(NamedTuple):
    """A text record."""

    number: int
    words: Words


class StepDecoder:
    """Messages -> Steps; takes a message of ``step/texts`` before the first of ``step`` that it belongs to."""

    def __init__(self) -> None:
        self._texts: dict[int, Texts] = {}
        self._prefix = b""
        self._slices: dict[str, slice] = {}
        self._texts_offset = 0

    def texts(self, data: bytes) -> None:
        """Takes a message of ``step/texts``."""
        texts = decode_texts(data)
        self._texts[texts.number] = texts

    def texts_of(self, data: bytes) -> Texts:
        """The text record of a message of ``step``; RecordingError when the bytes are none, or it was not taken."""
        if not self._prefix or not data.startswith(self._prefix):
            self._prefix, self._slices = read_layout(data)
            self._texts_offset = len(self._prefix) + 8 * self._slices["texts"].start
        number = int(_number.unpack_from(data, self._texts_offset)[0])
        texts = self._texts.get(number)
        if texts is None:
            raise RecordingError(f"text record {number} of a Step is missing")
        return texts

    def step(self, data: bytes) -> Step:
        """The Step of a message of ``step``.

        Raises RecordingError when the bytes are none, or when its text record was not taken.
        """
        texts = self.texts_of(data)
        numbers = np.frombuffer(data, "<f8", offset=len(self._prefix)).astype(np.float64)
        part = {label: numbers[place] for label, place in self._slices.items()}
        fields: dict[str, Any] = {name: part[name].copy() for name in ARRAYS}
        fields.update({name: fields[name].reshape(4, 4) for name in POSES})
        fields["closest_points"] = fields["closest_points"].reshape(2, 3)
        fields.update({name: float(part[name][0]) for name in NUMBERS})
        return Step(
            tick=int(part["tick"][0]),
            now=Instant(_time(part["now_monotonic"]), _time(part["now_ros"])),
            state_time_ns=_time(part["state_time"]),
            **texts.words._asdict(),
            **fields,
        )


def read_layout(data: bytes) -> tuple[bytes, dict[str, slice]]:
    """The bytes before the numbers of a ``step`` message, and the slice of the numbers behind each label."""
    message = deserialize(data, STEP_TYPE)
    sizes = {str(dim.label): int(dim.size) for dim in message.layout.dim}
    missing = [label for label in (*_HEAD, *ARRAYS, *NUMBERS) if label not in sizes]
    if missing:
        raise RecordingError(f"Step message without the slices {', '.join(missing)}; it has: {', '.join(sizes)}")
    slices, begin = {}, 0
    for label, size in sizes.items():
        slices[label] = slice(begin, begin + size)
        begin += size
    if begin != len(message.data):
        raise RecordingError(f"Step message holds {len(message.data)} numbers; its layout says {begin}")
    return data[: len(data) - 8 * begin], slices


def encode_texts(name: str, number: int, words: Words) -> bytes:
    """The message of one text record."""
    status = words.status
    pairs = [("number", str(number)), ("mode", status.mode.value)]
    pairs += [("binding", limit) for limit in words.binding]
    pairs += [("closest", part) for part in words.closest_pair]
    message = make(
        TEXTS_TYPE,
        level=status.level.value,
        name=name,
        message=status.reason,
        hardware_id="",
        values=[make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in pairs],
    )
    return serialize(message)


def decode_texts(data: bytes) -> Texts:
    """The text record in a message of ``step/texts``."""
    message = deserialize(data, TEXTS_TYPE)
    values = [(str(pair.key), str(pair.value)) for pair in message.values]
    single = dict(values)
    try:
        status = Status(Level(int(message.level)), Mode(single["mode"]), str(message.message))
        binding, closest = (tuple(value for key, value in values if key == wanted) for wanted in ("binding", "closest"))
        return Texts(int(single["number"]), Words(status, binding, closest))
    except (KeyError, ValueError) as error:
        raise RecordingError(f"text record of a Step cannot be read: {error}") from error


def encode_call(call: Call) -> bytes:
    """The message of one call."""
    return _CALL_TEMPLATE.fill(0, _call.pack(call.kind, call.sequence, *call.now))


def decode_call(data: bytes) -> Call:
    """The call in a message of ``calls``; RecordingError when the kind is unknown."""
    if len(data) <= _call.size:
        raise RecordingError(f"call record cannot be read: it has {len(data)} bytes")
    kind, sequence, monotonic_ns, ros_ns = _call.unpack_from(data, len(data) - _call.size)
    if kind not in _KINDS:
        raise RecordingError(f"call record cannot be read: {kind} is no valid kind")
    return Call(_KINDS[kind], sequence, Instant(monotonic_ns, ros_ns))


def _time(parts: Array) -> int:
    return int(parts[0]) * NS + int(parts[1])


def _sizes(n: int) -> dict[str, int]:
    joint = dict.fromkeys(("joint_position", "joint_velocity"), n)
    other = dict.fromkeys(POSES, 16) | {"singular_values": min(6, n)}
    return {name: joint.get(name, other.get(name, 6)) for name in ARRAYS}


def _dimension(label: str, size: int) -> object:
    return make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)


def _step_prefix(n: int) -> tuple[bytes, int]:
    """The bytes before the numbers of a ``step`` message, which are the same in all, and how many follow."""
    sizes = dict(zip(_HEAD, _HEAD_SIZES, strict=True)) | _sizes(n) | dict.fromkeys(NUMBERS, 1)
    dimensions = [_dimension(label, size) for label, size in sizes.items()]
    total = sum(sizes.values())
    layout = make("std_msgs/msg/MultiArrayLayout", dim=dimensions, data_offset=0)
    message = serialize(make(STEP_TYPE, layout=layout, data=np.zeros(total)))
    return message[: -8 * total], 8 * total


def _call_template() -> Template:
    label = "kind, sequence, monotonic_ns, ros_ns"
    layout = make("std_msgs/msg/MultiArrayLayout", dim=[_dimension(label, 4)], data_offset=0)
    return Template(make(CALL_TYPE, layout=layout, data=blank(4).view(np.int64)), (4,), stamped=False)


_CALL_TEMPLATE = _call_template()

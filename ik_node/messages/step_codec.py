"""Codec of Steps and controller calls: standard message types, restored bit for bit.

Three topics of a recording:

``step`` (std_msgs/Float64MultiArray): one message per control step. ``layout.dim`` lists label and size of consecutive
slices of ``data``; the labels after ``texts`` are the arrays and numbers of :class:`ik_node.interfaces.step.Step`, from
its declaration. A time is stored as two numbers, seconds and remaining nanoseconds, because one float64 cannot hold the
nanoseconds since the epoch. Matrices are row-major. ``texts`` is the number of the text record that applies.

``step/texts`` (diagnostic_msgs/DiagnosticStatus): text fields of the following Steps, written when they change. Level,
message = reason, and the key-value pairs ``number``, ``mode`` and one pair per entry of each field of names.

``calls`` (std_msgs/Int64MultiArray): every controller call in order: kind, sequence number of the input message on its
topic (-1 for none), monotonic ns, ROS ns.
"""

from __future__ import annotations

import struct
from enum import IntEnum
from math import prod
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from ik_node.errors import RecordingError
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import ARRAY_FIELDS, NUMBER_FIELDS, TEXT_FIELDS, Kind, Level, Mode, Status, Step
from ik_node.math.types import Array
from ik_node.messages.cdr import LITTLE_ENDIAN, Template, blank, deserialize, make, serialize

STEP_TYPE = "std_msgs/msg/Float64MultiArray"
TEXTS_TYPE = "diagnostic_msgs/msg/DiagnosticStatus"
CALL_TYPE = "std_msgs/msg/Int64MultiArray"

HEAD_SIZES = {"tick": 1, "now_monotonic": 2, "now_ros": 2, "state_time": 2, "texts": 1}
"""Slices before the arrays and numbers of a Step: counter, times, number of the text record."""
FIELDS = (*ARRAY_FIELDS, *NUMBER_FIELDS)
"""Fields of a Step that are slices, in the order of the message."""
_NAMES = tuple(field.name for field in TEXT_FIELDS if field.kind is Kind.NAMES)
MAX_COUNT = 2.0**53
"""Largest whole number in a float64 of which the next smaller one differs."""
_arrays = itemgetter(*(Step._fields.index(field.name) for field in ARRAY_FIELDS))
_numbers = itemgetter(*(Step._fields.index(field.name) for field in NUMBER_FIELDS))
_texts = itemgetter(*(Step._fields.index(field.name) for field in TEXT_FIELDS))
_head = struct.Struct("<8d")
_number = struct.Struct("<d")
_number_block = struct.Struct(f"<{len(NUMBER_FIELDS)}d")
_call = struct.Struct("<4q")
TextFields = tuple[Any, ...]
"""Values of :data:`ik_node.interfaces.step.TEXT_FIELDS`, in that order."""


class CallKind(IntEnum):
    """Called method of the controller, by the same name."""

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
    ON_INPUT_NOTE = 15
    ON_METHOD_FAULT = 16


_KINDS = {int(kind): kind for kind in CallKind}


class Call(NamedTuple):
    """One controller call."""

    kind: CallKind
    sequence: int
    """Number of the message that was passed in, counted on its topic; -1 for none."""
    now: Instant


class StepMessages(NamedTuple):
    """Messages of one Step."""

    texts: bytes | None
    """For the topic ``step/texts``, to be written before ``step``; None when unchanged."""
    step: bytes


class TextRecord(NamedTuple):
    """A message of ``step/texts``."""

    number: int
    fields: TextFields


def text_fields(step: Step) -> TextFields:
    """The text fields of a Step."""
    values: TextFields = _texts(step)
    return values


class StepEncoder:
    """Steps -> messages; keeps the last text record, so that one is written only when it changes."""

    def __init__(self, name: str, n: int) -> None:
        """``name``: full name of the node; ``n``: number of joints."""
        self._name = name
        self._prefix, size = _step_prefix(n)
        self._length = len(self._prefix) + size
        self._number = -1
        self._last: TextFields | None = None
        no_names = [Status(Level.OK, Mode.WAITING, "") if field.kind is Kind.STATUS else () for field in TEXT_FIELDS]
        encode_texts(name, 0, tuple(no_names))  # compiles the serialiser before the first control step

    def repeat_texts(self) -> None:
        """Encodes the texts with the next Step again, because the last record could not be written."""
        self._last = None

    def encode(self, step: Step) -> StepMessages:
        """Encodes a Step.

        Args:
            step: A Step of ``n`` joints.

        Returns:
            The message of the topic ``step``, and that of ``step/texts`` when the text fields changed.

        Raises:
            RecordingError: The Step has another number of joints.
        """
        texts, number, fields = None, self._number, text_fields(step)
        if fields != self._last:
            number += 1
            texts = encode_texts(self._name, number, fields)
        numbers = self.numbers(step, number)
        self._last, self._number = fields, number
        return StepMessages(texts, numbers)

    def numbers(self, step: Step, text_number: int) -> bytes:
        """The ``step`` message that refers to text record ``text_number``."""
        now_s, now_ns = divmod(step.now.monotonic_ns, NS)
        ros_s, ros_ns = divmod(step.now.ros_ns, NS)
        state_s, state_ns = divmod(step.state_time_ns, NS)
        data = b"".join(
            (
                self._prefix,
                _head.pack(step.tick, now_s, now_ns, ros_s, ros_ns, state_s, state_ns, text_number),
                *[values.tobytes() for values in _arrays(step)],
                _number_block.pack(*_numbers(step)),
            )
        )
        if len(data) != self._length:
            raise RecordingError(f"Step message has {len(data)} bytes, expected {self._length}: other number of joints")
        return data


class StepDecoder:
    """Messages -> Steps; a ``step/texts`` message must be passed in before the ``step`` messages that refer to it."""

    def __init__(self) -> None:
        self._texts: dict[int, TextRecord] = {}
        self._prefix = b""
        self._length = 0
        self._slices: dict[str, slice] = {}
        self._shapes: dict[str, tuple[int, ...]] = {}
        self._texts_offset = 0

    def texts(self, data: bytes) -> None:
        """Stores a message of ``step/texts``."""
        record = decode_texts(data)
        self._texts[record.number] = record

    def texts_of(self, data: bytes) -> TextRecord:
        """The text record of a ``step`` message; raises RecordingError when either is invalid or missing."""
        if not self._prefix or len(data) != self._length or not data.startswith(self._prefix):
            self._prefix, self._slices = read_layout(data)
            self._length = len(data)
            self._shapes = shapes(self._slices)
            self._texts_offset = len(self._prefix) + 8 * self._slices["texts"].start
        number = _whole(_number.unpack_from(data, self._texts_offset)[0])
        texts = self._texts.get(number)
        if texts is None:
            raise RecordingError(f"text record {number} of a Step is missing")
        return texts

    def step(self, data: bytes) -> Step:
        """Decodes a ``step`` message.

        Args:
            data: CDR bytes.

        Returns:
            The Step with all bits of the encoded one.

        Raises:
            RecordingError: The bytes are no Step, or its text record was not passed in.
        """
        record = self.texts_of(data)
        numbers = np.frombuffer(data, "<f8", offset=len(self._prefix)).astype(np.float64)
        slices = {label: numbers[place] for label, place in self._slices.items()}
        values: dict[str, Any] = {
            field.name: slices[field.name].reshape(self._shapes[field.name]).copy() for field in ARRAY_FIELDS
        }
        values.update({field.name: float(slices[field.name][0]) for field in NUMBER_FIELDS})
        values.update({field.name: value for field, value in zip(TEXT_FIELDS, record.fields, strict=True)})
        return Step(
            tick=_whole(slices["tick"][0]),
            now=Instant(_time(slices["now_monotonic"]), _time(slices["now_ros"])),
            state_time_ns=_time(slices["state_time"]),
            **values,
        )


def read_layout(data: bytes) -> tuple[bytes, dict[str, slice]]:
    """The bytes before the numbers of a ``step`` message, and label -> slice of the numbers.

    Raises RecordingError naming the slices when one is missing or the sizes do not match the data, which must be as
    :class:`StepEncoder` writes them: little-endian, and without bytes behind the message.
    """
    message = deserialize(data, STEP_TYPE)
    sizes = {str(dim.label): int(dim.size) for dim in message.layout.dim}
    missing = [label for label in (*HEAD_SIZES, *(field.name for field in FIELDS)) if label not in sizes]
    if missing:
        raise RecordingError(f"Step message without the slices {', '.join(missing)}; it has: {', '.join(sizes)}")
    if data[:2] != LITTLE_ENDIAN or len(data) != len(serialize(message)):
        raise RecordingError(f"Step message of {len(data)} bytes is big-endian or has more bytes than its layout")
    for label, size in HEAD_SIZES.items():
        if sizes[label] != size:
            raise RecordingError(f"slice {label} of a Step message has {sizes[label]} numbers, expected {size}")
    slices, begin = {}, 0
    for label, size in sizes.items():
        slices[label] = slice(begin, begin + size)
        begin += size
    if begin != len(message.data):
        raise RecordingError(f"Step message has {len(message.data)} numbers, but its layout declares {begin}")
    for name, shape in shapes(slices).items():
        if sizes[name] != prod(shape):
            raise RecordingError(f"slice {name} of a Step message has {sizes[name]} numbers, expected {prod(shape)}")
    return data[: len(data) - 8 * begin], slices


def shapes(slices: dict[str, slice]) -> dict[str, tuple[int, ...]]:
    """Field -> shape of its value, for slices of :func:`read_layout`."""
    joints = slices["joint_position"]
    n = joints.stop - joints.start
    return {field.name: field.shape(n) for field in FIELDS}


def encode_texts(name: str, number: int, fields: TextFields) -> bytes:
    """The message of one text record; ``name``: full name of the node."""
    values = {field.name: value for field, value in zip(TEXT_FIELDS, fields, strict=True)}
    status: Status = values["status"]
    pairs = [("number", str(number)), ("mode", status.mode.value)]
    pairs += [(field, entry) for field in _NAMES for entry in values[field]]
    message = make(
        TEXTS_TYPE,
        level=status.level.value,
        name=name,
        message=status.reason,
        hardware_id="",
        values=[make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in pairs],
    )
    return serialize(message)


def decode_texts(data: bytes) -> TextRecord:
    """The text record in a message of ``step/texts``; raises RecordingError when it is none."""
    message = deserialize(data, TEXTS_TYPE)
    pairs = [(str(pair.key), str(pair.value)) for pair in message.values]
    single = dict(pairs)
    try:
        status = Status(Level(int(message.level)), Mode(single["mode"]), str(message.message))
        values: list[Any] = [
            status if field.kind is Kind.STATUS else tuple(value for key, value in pairs if key == field.name)
            for field in TEXT_FIELDS
        ]
        return TextRecord(int(single["number"]), tuple(values))
    except (KeyError, ValueError) as error:
        raise RecordingError(f"text record of a Step cannot be read: {error}") from error


def encode_call(call: Call) -> bytes:
    """The message of a call."""
    return _CALL_TEMPLATE.fill(0, _call.pack(call.kind, call.sequence, *call.now))


def decode_call(data: bytes) -> Call:
    """The call in a message of ``calls``; raises RecordingError when it is none or its kind is unknown."""
    if len(data) <= _call.size:
        raise RecordingError(f"call record cannot be read: it has {len(data)} bytes")
    kind, sequence, monotonic_ns, ros_ns = _call.unpack_from(data, len(data) - _call.size)
    if kind not in _KINDS:
        raise RecordingError(f"call record cannot be read: unknown kind {kind}")
    return Call(_KINDS[kind], sequence, Instant(monotonic_ns, ros_ns))


def _time(parts: Array) -> int:
    return _whole(parts[0]) * NS + _whole(parts[1])


def _whole(number: float) -> int:
    """A counter or a part of a time; raises RecordingError when it is none."""
    if not abs(number) <= MAX_COUNT:
        raise RecordingError(f"Step message with the number {number:g}, which is no counter or time")
    return int(number)


def _dimension(label: str, size: int) -> object:
    return make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=size)


def _step_prefix(n: int) -> tuple[bytes, int]:
    """The constant bytes before the numbers of a ``step`` message, and the size of the numbers in bytes."""
    sizes = HEAD_SIZES | {field.name: prod(field.shape(n)) for field in FIELDS}
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

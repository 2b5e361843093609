"""Bags that were not recorded by this package as a source of calls: rosbag2 (sqlite3 or MCAP) and rosbag1.

Such a bag contains no calls. They are generated as the node would make them: every message at the time at which it was
recorded, on both clocks, and a clock call every 10 ms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ik_node.control.controller import Controller
from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import NS, Instant
from ik_node.math.types import Array
from ik_node.messages.decode import decode_joint_state, decode_string
from ik_node.messages.decode_targets import decode_pose
from ik_node.messages.encode import encode_joint_state
from ik_node.messages.step_codec import Call, CallKind
from ik_node.recording.bag_reader import BagReader
from ik_node.recording.call_log import RecordedCall
from ik_node.recording.input_table import INPUTS, JOINT_STATES
from ik_node.recording.mcap.reader import Topic
from ik_node.recording.run import RecordedTargets
from ik_node.recording.run_recorder import STEP
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.robot import Robot
from ik_node.settings.groups import Settings

CLOCK_PERIOD_NS = NS // 100
"""Period of the controller's clock call in the node."""
LONGEST_GAP_NS = 60 * NS
"""Time without messages after which clock calls are left out: six times the longest ``timeout_s``, so that the arm has
been ramped down. A bag whose times leap by years would otherwise make a call every 10 ms of them."""
GAP_END_NS = 3 * NS
"""Clock calls of the end of a gap that are made: their rate, of which the controller keeps a mean over
:data:`ik_node.control.step_timer.RATE_WINDOW_S`, is that of the node again when the next message comes."""
DESCRIPTION = "robot_description"
RATE_MARGIN = 1.1
"""Ratio of rate_hz to the rate of the joint states; above 1, so that each of them makes a control step."""
_KIND_OF = {entry.name: kind for kind, entry in INPUTS.items()}
_TYPES = {**{entry.name: entry.type_name for entry in INPUTS.values()}, DESCRIPTION: "std_msgs/msg/String"}


class ExternalBag:
    """A bag as a :class:`ik_node.replay.call_source.CallSource`."""

    def __init__(
        self,
        path: Path,
        settings: Settings,
        remap: Mapping[str, str] | None = None,
        start: tuple[float, ...] = (),
    ) -> None:
        """Opens a bag.

        Args:
            path: Folder or file.
            settings: Settings of the controller; ``rate_hz`` is replaced by the rate of the joint states, if any.
            remap: Topic of the bag -> input of the node.
            start: Initial joint positions (n,), for a bag without joint states.

        Raises:
            RecordingError: The bag cannot be read or contains no input; the message lists its topics.
            RobotError: Neither the settings nor the bag name a robot.
        """
        self.path = path
        self._remap = dict(remap or {})
        self._start = start
        self._reader = BagReader(path)
        self.used = self._inspect()
        """Topic of the bag -> input of the node, and number of messages."""
        self._urdf = self._description()
        self._robot = robot_from_settings(settings.arm, self._urdf)
        self.initial_settings = self._at_its_rate(settings)
        has_states = any(name == JOINT_STATES for name, _ in self.used.values())
        if not has_states and len(start) != self._robot.n:
            joints = ", ".join(self._robot.joints)
            raise RecordingError(f"'{path}' holds no joint states; give the initial positions of {joints}")

    def robot(self) -> Robot:
        """A new robot, from the settings or from the bag."""
        return robot_from_settings(self.initial_settings.arm, self._urdf)

    def controller(self, settings: Settings | None = None) -> Controller:
        """A new controller."""
        return Controller(self.robot(), settings or self.initial_settings)

    def settings(self, recorded: RecordedCall) -> Settings:
        """The initial settings: such a bag contains no parameter changes."""
        del recorded
        return self.initial_settings

    def entries(self) -> Iterator[RecordedCall]:
        """The messages as calls, with clock calls between them.

        After :data:`LONGEST_GAP_NS` without a message only the clock calls of the last :data:`GAP_END_NS` of the gap
        are made. The Steps are the same: without joint states the controller is at rest by then, and at rest a clock
        call changes nothing but the time, of which the next call has its own, and the number and rate of such calls.
        """
        number = 0
        next_ns = last_ns = 0
        for kind, time_ns, data in self._messages():
            next_ns = next_ns or time_ns + CLOCK_PERIOD_NS
            while next_ns <= time_ns:
                if last_ns + LONGEST_GAP_NS < next_ns < time_ns - GAP_END_NS:
                    next_ns += (time_ns - GAP_END_NS - next_ns) // CLOCK_PERIOD_NS * CLOCK_PERIOD_NS
                yield RecordedCall(number, Call(CallKind.ON_CLOCK, -1, Instant(next_ns, next_ns)), b"", None)
                next_ns += CLOCK_PERIOD_NS
                number += 1
            yield RecordedCall(number, Call(kind, number, Instant(time_ns, time_ns)), data, None)
            number += 1
            last_ns = time_ns

    def targets(self) -> RecordedTargets:
        """All target poses that can be decoded."""
        found = [
            (time_ns, decode_pose(data)) for kind, time_ns, data in self._messages() if kind is CallKind.ON_TARGET_POSE
        ]
        times = np.array([time_ns for time_ns, _ in found], dtype=np.int64)
        return RecordedTargets(
            times_s=(times - times[0]) / NS if len(times) else np.zeros(0),
            received_ros_ns=times,
            stamp_ns=np.array([pose.stamp_ns for _, pose in found], dtype=np.int64),
            position=np.array([pose.position for _, pose in found]).reshape(-1, 3),
            quaternion_xyzw=np.array([pose.quaternion for _, pose in found]).reshape(-1, 4),
            frame_ids=tuple(pose.frame_id for _, pose in found),
        )

    @property
    def base_frame(self) -> str:
        """Frame {s} of the robot."""
        return self._robot.base_frame

    # --- the bag -----------------------------------------------------------------------------------------------------

    def _input_of(self, topic: Topic) -> str:
        """The input that a topic is used for, by remapping or by its name; empty for none."""
        if topic.name in self._remap:
            name = self._remap[topic.name]
            if name not in _TYPES:
                raise RecordingError(f"unknown input '{name}'; valid: {', '.join(_TYPES)}")
            if topic.type_name != _TYPES[name]:
                expected = f"{name} takes {_TYPES[name]}"
                raise RecordingError(f"topic '{topic.name}' has type {topic.type_name}; {expected}")
            return name
        name = topic.name.rpartition("/")[2]
        free = name not in self._remap.values()
        return name if free and _TYPES.get(name) == topic.type_name else ""

    def _inspect(self) -> dict[str, tuple[str, int]]:
        counts = self._reader.counts
        used: dict[str, tuple[str, int]] = {}
        for topic, count in counts.items():
            name = self._input_of(topic)
            if name:
                used[topic.name] = (name, used.get(topic.name, (name, 0))[1] + count)
        missing = [name for name in self._remap if name not in {topic.name for topic in counts}]
        held = ", ".join(f"{topic.name} ({topic.type_name}, {count})" for topic, count in counts.items()) or "nothing"
        if missing:
            raise RecordingError(f"'{self.path}' has no topic {', '.join(missing)}; it holds: {held}")
        if not any(count for name, count in used.values() if name in _KIND_OF):
            valid = ", ".join(f"{name} ({kind})" for name, kind in _TYPES.items())
            raise RecordingError(
                f"'{self.path}' holds no input of the controller: {valid}; it holds: {held}."
                " Use --remap TOPIC:=INPUT for topics with other names"
            )
        return used

    def _description(self) -> str:
        topics = [topic for topic, (name, count) in self.used.items() if name == DESCRIPTION and count]
        for _, data in self._raw(topics[:1]):
            return decode_string(data[1])
        return ""

    def _raw(self, topics: list[str]) -> Iterator[tuple[str, tuple[int, bytes]]]:
        """Topic, and time and CDR bytes of each message, in the order of their times."""
        for topic, time_ns, data in self._reader.messages(topics):
            yield topic, (time_ns, data)

    def _messages(self) -> Iterator[tuple[CallKind, int, bytes]]:
        """The used messages; those that cannot be decoded are left out."""
        topics = [topic for topic, (name, _) in self.used.items() if name in _KIND_OF]
        generated = self._generated_states()
        pending = next(generated, None)
        for topic, (time_ns, data) in self._raw(topics):
            while pending is not None and pending[1] <= time_ns:
                yield pending
                pending = next(generated, None)
            name = self.used[topic][0]
            try:
                INPUTS[_KIND_OF[name]].decode(data)
            except InputError:
                continue
            yield _KIND_OF[name], time_ns, data
        if pending is not None:
            yield pending
            yield from generated

    def _generated_states(self) -> Iterator[tuple[CallKind, int, bytes]]:
        """Joint states at ``start`` for a bag without any: at ``rate_hz``, for its duration and one more second.

        In gaps they end after :data:`LONGEST_GAP_NS`.
        """
        if not self._start:
            return
        times = sorted(time_ns for _, (time_ns, _) in self._raw(list(self.used)))
        position: Array = np.array(self._start, dtype=np.float64)
        period_ns = round(NS / self.initial_settings.control.rate_hz)
        next_ns = times[0]
        for time_ns, following_ns in zip(times, [*times[1:], times[-1] + NS], strict=True):
            while next_ns < min(following_ns, time_ns + LONGEST_GAP_NS):
                yield _KIND_OF[JOINT_STATES], next_ns, encode_joint_state(self._robot.joints, next_ns, position)
                next_ns += period_ns
            if next_ns < following_ns:  # a gap
                next_ns += -((next_ns - following_ns) // period_ns) * period_ns

    def _at_its_rate(self, settings: Settings) -> Settings:
        topics = [topic for topic, (name, _) in self.used.items() if name == JOINT_STATES]
        controlled = set(self._robot.joints)
        times = [time_ns for _, (time_ns, data) in self._raw(topics) if topics and controlled & set(_names(data))]
        if len(times) < 2:
            return settings
        rate_hz = RATE_MARGIN * NS / max(float(np.median(np.diff(times))), 1.0)
        return settings.with_values({"rate_hz": min(max(rate_hz, 10.0), 2000.0)})


def is_external_bag(path: Path) -> bool:
    """True for a bag without the topics of a run of this package."""
    try:
        return not any(topic.name.endswith(f"/{STEP}") for topic in BagReader(path).counts)
    except RecordingError:
        return False


def _names(data: bytes) -> tuple[str, ...]:
    """Joints of a joint state; none when it cannot be decoded."""
    try:
        return decode_joint_state(data).names
    except InputError:
        return ()

"""Publishes recorded inputs to a running node, at their recorded times."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from itertools import chain
from typing import Any

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from ik_node.errors import InputError, RecordingError
from ik_node.interfaces.clock import NS
from ik_node.messages.restamp import restamped
from ik_node.messages.step_codec import CallKind
from ik_node.recording.call_log import RecordedCall
from ik_node.recording.input_table import INPUTS
from ik_node.replay.call_source import CallSource, calls
from ik_node.ros import qos
from ik_node.ros.message_types import message_class

DISCOVERY_TIMEOUT_S = 10.0
"""Longest wait for a subscription."""
POLL_PERIOD_S = 0.05


def play(source: CallSource, node_name: str, inputs: Collection[str]) -> dict[str, int]:
    """Publish recorded inputs to a running node.

    Stamps are shifted, so that each message has the same age as when it was recorded.

    Args:
        source: Recording or external bag.
        node_name: Full name of the node.
        inputs: Names of the inputs to publish; all when empty.

    Returns:
        Name of the input -> number of published messages.

    Raises:
        InputError: There is no input of that name; the message lists them.
        RecordingError: The recording holds none of the inputs, or the node has no subscription to them.
    """
    unknown = sorted(set(inputs) - {entry.name for entry in INPUTS.values()})
    if unknown:
        valid = ", ".join(entry.name for entry in INPUTS.values())
        raise InputError(f"unknown input {', '.join(unknown)}; valid: {valid}")
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _Player(node_name.rstrip("/")).play(_selected(source, inputs))
    finally:
        rclpy.try_shutdown()


def _selected(source: CallSource, inputs: Collection[str]) -> Iterator[RecordedCall]:
    for recorded in calls(source):
        if recorded.call.kind in INPUTS and (not inputs or INPUTS[recorded.call.kind].name in inputs):
            yield recorded


class _Player:
    def __init__(self, node_name: str) -> None:
        self._name = node_name
        self._node: Any = rclpy.create_node("ik_replay")
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._publishers = {kind: self._publisher(kind) for kind in INPUTS}

    def play(self, recorded_calls: Iterator[RecordedCall]) -> dict[str, int]:
        counts = dict.fromkeys((entry.name for entry in INPUTS.values()), 0)
        first = next(recorded_calls, None)
        if first is None:
            raise RecordingError("the recording holds none of these inputs")
        self._wait_for_subscription()
        first_ns = first.call.now.monotonic_ns
        start_ns, start_ros_ns = time.monotonic_ns(), int(self._node.get_clock().now().nanoseconds)
        shift_ns = start_ros_ns - first.call.now.ros_ns
        for recorded in chain([first], recorded_calls):
            self._wait_until(start_ns + recorded.call.now.monotonic_ns - first_ns)
            entry = INPUTS[recorded.call.kind]
            self._publishers[recorded.call.kind].publish(restamped(recorded.data, entry.type_name, shift_ns))
            counts[entry.name] += 1
        self._executor.shutdown(0.5)
        return counts

    def _publisher(self, kind: CallKind) -> Any:
        entry = INPUTS[kind]
        namespace = self._name.rpartition("/")[0]
        topic = entry.topic.replace("~", self._name) if "~" in entry.topic else f"{namespace}/{entry.topic}"
        return self._node.create_publisher(message_class(entry.type_name), topic, qos.OUTPUT)

    def _wait_for_subscription(self) -> None:
        end_s = time.monotonic() + DISCOVERY_TIMEOUT_S
        while not any(publisher.get_subscription_count() for publisher in self._publishers.values()):
            if time.monotonic() > end_s:
                raise RecordingError(f"there is no subscription to the inputs of node '{self._name}'")
            self._executor.spin_once(POLL_PERIOD_S)

    def _wait_until(self, due_ns: int) -> None:
        while (left_s := (due_ns - time.monotonic_ns()) / NS) > 0.0:
            self._executor.spin_once(min(left_s, POLL_PERIOD_S))

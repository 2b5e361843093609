"""Recorded inputs to a running node, at the pace at which they were recorded."""

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
from ik_node.recording.call_log import Event
from ik_node.recording.input_table import INPUTS
from ik_node.replay.call_source import Source, calls
from ik_node.ros import qos
from ik_node.ros.message_types import message_class

DISCOVERY_S = 10.0
"""How long a node is waited for."""
LONGEST_WAIT_S = 0.05


def feed(source: Source, node_name: str, wanted: Collection[str]) -> dict[str, int]:
    """Publishes the inputs ``wanted`` (all when empty) to ``node_name``; returns how many messages of each.

    Stamps move along, so that messages are as old when they are sent as they were then. Raises RecordingError when
    there is nothing to publish or nobody listens, InputError naming an input that does not exist.
    """
    unknown = sorted(set(wanted) - {entry.name for entry in INPUTS.values()})
    if unknown:
        valid = ", ".join(entry.name for entry in INPUTS.values())
        raise InputError(f"unknown input {', '.join(unknown)}; valid: {valid}")
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        return _Feeder(node_name.rstrip("/")).feed(_chosen(source, wanted))
    finally:
        rclpy.try_shutdown()


def _chosen(source: Source, wanted: Collection[str]) -> Iterator[Event]:
    for event in calls(source):
        if event.call.kind in INPUTS and (not wanted or INPUTS[event.call.kind].name in wanted):
            yield event


class _Feeder:
    def __init__(self, node_name: str) -> None:
        self._name = node_name
        self._node: Any = rclpy.create_node("ik_replay")
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._publishers = {kind: self._publisher(kind) for kind in INPUTS}

    def feed(self, events: Iterator[Event]) -> dict[str, int]:
        counts = dict.fromkeys((entry.name for entry in INPUTS.values()), 0)
        first = next(events, None)
        if first is None:
            raise RecordingError("the recording holds none of these inputs")
        self._wait_for_listener()
        begin_ns = first.call.now.monotonic_ns
        start_ns, start_ros_ns = time.monotonic_ns(), int(self._node.get_clock().now().nanoseconds)
        later_ns = start_ros_ns - first.call.now.ros_ns
        for event in chain([first], events):
            self._wait_until(start_ns + event.call.now.monotonic_ns - begin_ns)
            entry = INPUTS[event.call.kind]
            self._publishers[event.call.kind].publish(restamped(event.data, entry.type_name, later_ns))
            counts[entry.name] += 1
        self._executor.shutdown(0.5)
        return counts

    def _publisher(self, kind: CallKind) -> Any:
        entry = INPUTS[kind]
        namespace = self._name.rpartition("/")[0]
        topic = entry.topic.replace("~", self._name) if "~" in entry.topic else f"{namespace}/{entry.topic}"
        return self._node.create_publisher(message_class(entry.type_name), topic, qos.OUTPUT)

    def _wait_for_listener(self) -> None:
        until = time.monotonic() + DISCOVERY_S
        while not any(publisher.get_subscription_count() for publisher in self._publishers.values()):
            if time.monotonic() > until:
                raise RecordingError(f"nobody listens to the inputs of node '{self._name}'")
            self._executor.spin_once(LONGEST_WAIT_S)

    def _wait_until(self, due_ns: int) -> None:
        while (left_s := (due_ns - time.monotonic_ns()) / NS) > 0.0:
            self._executor.spin_once(min(left_s, LONGEST_WAIT_S))

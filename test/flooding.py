"""A process that floods inputs of a node: ``python flooding.py SPECIFICATION``, until SIGTERM.

It is a process of its own, so that the time that it takes is not the time of the test or of the node.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

from waiting import ENOUGH_S

BYTES_PER_S = 20e6
"""Large messages are sent at a lower rate than asked for."""
SET_PARAMETERS = "set_parameters"
"""Topic of a flood of requests to change a parameter, without waiting for the responses."""


class Flood(NamedTuple):
    """One flooded input."""

    topic: str
    type_name: str
    data: bytes
    rate_hz: float = 1000.0
    latched: bool = False
    """Published so that late subscribers receive the last one."""


@contextmanager
def flooding(floods: Sequence[Flood], domain: int, folder: Path) -> Iterator[Path]:
    """Flood inputs for the duration of the context; yields a file with the number of messages sent so far."""
    specification, count = folder / "flood.json", folder / "flood.count"
    entries = [{**flood._asdict(), "data": flood.data.hex()} for flood in floods]
    specification.write_text(json.dumps({"floods": entries, "count": str(count)}))
    count.write_text("0")
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    process = subprocess.Popen([sys.executable, __file__, str(specification)], env=environment)
    try:
        yield count
    finally:
        process.send_signal(signal.SIGTERM)
        assert process.wait(ENOUGH_S) == 0


def _senders(node: Any, floods: Sequence[Flood]) -> list[tuple[Any, float]]:
    """A function that sends one message, and its period in s, for each flood."""
    from rcl_interfaces.msg import Parameter, ParameterValue
    from rcl_interfaces.srv import SetParameters

    from ik_node.ros import qos
    from ik_node.ros.message_types import message_class

    senders: list[tuple[Any, float]] = []
    for flood in floods:
        period_s = max(1.0 / flood.rate_hz, len(flood.data) / BYTES_PER_S)
        if flood.topic.endswith(SET_PARAMETERS):
            client = node.create_client(SetParameters, flood.topic)
            value = ParameterValue(type=3, double_value=3.0)
            request = SetParameters.Request(parameters=[Parameter(name=flood.data.decode(), value=value)])

            def ask(client: Any = client, request: Any = request) -> None:
                client.remove_pending_request(client.call_async(request))

            senders.append((ask, period_s))
        else:
            profile = qos.LATCHED if flood.latched else qos.OUTPUT
            publisher = node.create_publisher(message_class(flood.type_name), flood.topic, profile)

            def send(publisher: Any = publisher, data: bytes = flood.data) -> None:
                publisher.publish(data)

            senders.append((send, period_s))
    return senders


def main(specification: Path) -> None:
    """Send until SIGTERM."""
    import rclpy
    from rclpy.node import Node
    from rclpy.signals import SignalHandlerOptions

    ended = False

    def on_signal(number: int, frame: FrameType | None) -> None:
        nonlocal ended
        del number, frame
        ended = True

    signal.signal(signal.SIGTERM, on_signal)
    given = json.loads(specification.read_text())
    floods = [Flood(**{**entry, "data": bytes.fromhex(entry["data"])}) for entry in given["floods"]]
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    node = Node("flood")
    senders = _senders(node, floods)
    due_s = [time.monotonic()] * len(senders)
    sent, report_s = 0, time.monotonic()
    while not ended:
        now_s = time.monotonic()
        for index, (send, period_s) in enumerate(senders):
            if now_s >= due_s[index]:
                send()
                sent += 1
                due_s[index] = max(due_s[index] + period_s, now_s - 0.01)
        if now_s > report_s:
            written = Path(f"{given['count']}.new")
            written.write_text(str(sent))
            written.replace(given["count"])  # never seen empty
            report_s = now_s + 0.1
        left_s = min(due_s) - time.monotonic()
        if left_s > 2e-4:
            time.sleep(left_s)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

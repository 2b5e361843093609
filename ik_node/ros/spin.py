"""Start, spin and stop of a process with one node, so that the last word to the robot always gets out.

rclpy's own signal handling invalidates the context before a last zero command can leave, and loses signals under
traffic; so signals only set a future here, and a timer lets Python see them. EventsExecutor is the one that keeps up at
1 kHz; it must never be given an infinite deadline.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from ik_node.errors import IkNodeError
from ik_node.ros.child_process import end_with_parent_if_asked

SIGNAL_POLL_S = 0.05
"""How often Python gets to see a signal when nothing else happens."""
LONGEST_S = 1e6
"""Stands for "for ever": the executor hangs on an infinite deadline."""


def run(make_node: Callable[[], Any], finish: Callable[[Any, Any], None], arguments: Sequence[str] | None) -> int:
    """Makes the node, spins it until SIGINT, SIGTERM or its future ``node.stopped``, calls ``finish(node, executor)``.

    Returns the process's exit code; an error of ours on the way is printed and gives 1.
    """
    end_with_parent_if_asked()
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    stopped = Future()

    def on_signal(number: int, frame: FrameType | None) -> None:
        del number, frame
        if not stopped.done():
            stopped.set_result(None)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    executor = EventsExecutor()
    try:
        node = make_node()
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        rclpy.shutdown()
        return 1
    node.create_timer(SIGNAL_POLL_S, lambda: None)
    executor.add_node(node)
    try:
        executor.spin_until_future_complete(stopped, LONGEST_S)
    except ExternalShutdownException:
        pass
    finally:
        try:
            finish(node, executor)
        finally:
            executor.shutdown(0.5)
            node.destroy_node()
            rclpy.try_shutdown()
    return 0

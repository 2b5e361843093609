"""Start, spin and stop a process with one node, so that the final zero command is always sent.

The signal handlers of rclpy invalidate the context before a final zero command can be sent, and lose signals under
load. Here signals only complete a future, and a timer lets Python run its signal handlers. EventsExecutor is the
executor that keeps up at 1 kHz; it hangs on an infinite timeout.
"""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.task import Future

from ik_node.errors import IkNodeError, SettingsError
from ik_node.ros import start_arguments
from ik_node.ros.child_process import end_with_parent_if_requested
from ik_node.ros.steady_timer import create_steady_timer

SIGNAL_POLL_S = 0.05
"""Longest time until Python handles a signal while no callback runs."""
SPIN_TIMEOUT_S = 1e6
"""Replaces an infinite timeout."""
UNUSABLE = 2
"""Exit code when ROS cannot read the arguments."""


def run(make_node: Callable[[], Any], finish: Callable[[Any, Any], None], arguments: Sequence[str] | None) -> int:
    """Make a node and spin it until SIGINT, SIGTERM or SIGHUP.

    Args:
        make_node: Makes the node, after rclpy was initialised.
        finish: Called with node and executor before the node is destroyed.
        arguments: Arguments for rclpy, without the program's name; None takes those of the process.

    Returns:
        Exit code of the process: 0; 1 when ``make_node`` raised an IkNodeError, which is printed, or ROS refused a
        parameter; 2 when ROS cannot read the arguments.
    """
    end_with_parent_if_requested()
    try:
        start_arguments.initialise(arguments)
    except SettingsError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    stopped = Future()

    def on_signal(number: int, frame: FrameType | None) -> None:
        del number, frame
        if not stopped.done():
            stopped.set_result(None)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, on_signal)
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # ignored under nohup
        signal.signal(signal.SIGHUP, on_signal)
    executor = EventsExecutor()
    try:
        node = make_node()
    except (IkNodeError, ParameterException) as error:
        print(f"error: {error}", file=sys.stderr)
        rclpy.shutdown()
        return 1
    create_steady_timer(node, SIGNAL_POLL_S, lambda: None)
    executor.add_node(node)
    try:
        executor.spin_until_future_complete(stopped, SPIN_TIMEOUT_S)
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

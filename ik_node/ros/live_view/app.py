"""Serves the page of a running node."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from ik_node.report.quantities import UNWEIGHTED
from ik_node.robot.catalogue import robot_from_settings
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.ros.live_view.listener import LiveViewListener
from ik_node.ros.live_view.live_timeline import STALE_S, LiveTimeline
from ik_node.settings.groups import Settings
from ik_node.viewer.open_run import load_meshes
from ik_node.viewer.page import PageContent, ViewerPage

MAX_SPIN_S = 1e6
"""Longer than any session; the executor hangs on an infinite deadline."""
PERIOD_S = 1.0 / 30.0
KEPT_S = 120.0
"""Length of the live timeline."""
NICE = 10
"""The process runs at a lower priority than the controller."""


def view_live(
    watched: str,
    make_server: Callable[[], Any],
    ready: Callable[[Any], None],
    arguments: Sequence[str] = (),
    timeout_s: float = 10.0,
) -> None:
    """Serves the page of a running node until KeyboardInterrupt.

    Args:
        watched: Name of the node.
        make_server: Starts the viser server.
        ready: Called with the server when the page exists.
        arguments: ROS arguments.
        timeout_s: Time to wait for the node's parameters and robot description.

    Raises:
        IkNodeError: No node of that name answers in time, or its robot model cannot be loaded.
    """
    os.nice(NICE)
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    executor, done = EventsExecutor(), Future()
    node = LiveViewListener(watched if watched.startswith("/") else f"/{watched}")
    executor.add_node(node)
    thread = threading.Thread(target=_spin, args=(executor, done), daemon=True)
    thread.start()
    try:
        settings = node.request_settings(timeout_s)
        robot = _robot(node, settings, timeout_s)
        server = make_server()
        try:
            timeline = LiveTimeline(node, robot, settings, round(KEPT_S / PERIOD_S))
            begin_s = time.monotonic()
            _wait_for_joint_state(timeline, begin_s)
            page = _page(server, node, timeline, settings)
            timeline.buffer.clear()
            ready(server)
            _run(page, timeline, begin_s)
        finally:
            server.stop()
    finally:
        done.set_result(None)
        thread.join(2.0)
        executor.shutdown(0.5)
        node.destroy_node()
        rclpy.try_shutdown()


def _spin(executor: Any, done: Future) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin_until_future_complete(done, MAX_SPIN_S)


def _robot(node: LiveViewListener, settings: Settings, timeout_s: float) -> Robot:
    """The robot of the running node; waits for its description if it is published on a topic."""
    deadline_s = time.monotonic() + timeout_s
    configured = settings.arm.robot or settings.arm.robot_description
    while not configured and not node.robot_description and time.monotonic() < deadline_s:
        time.sleep(0.05)
    return robot_from_settings(settings.arm, node.robot_description)


def _wait_for_joint_state(timeline: LiveTimeline, begin_s: float) -> None:
    """Waits up to STALE_S for joint states, which the initial camera needs."""
    while not timeline.has_joint_state and time.monotonic() - begin_s < STALE_S:
        timeline.sample(time.monotonic() - begin_s)
        time.sleep(PERIOD_S)


def _page(server: Any, node: LiveViewListener, timeline: LiveTimeline, settings: Settings) -> ViewerPage:
    robot = timeline.robot
    parts, notes = load_meshes(robot, settings.obstacles.package_path)
    gain = settings.control.gradient_gain
    content = PageContent(
        title=f"{settings.arm.robot or robot.name}, live from {node.watched}",
        robot=robot,
        parts=parts,
        velocity_limits=motion_limits(robot, settings.limits, settings.control.rate_hz).velocity,
        mass_weighted=settings.control.method not in UNWEIGHTED,
        gradient_gain=lambda _: gain,
        scene_at=timeline.scenes,
        tolerance_at=timeline.tolerance_at,
        targets=lambda: np.array(timeline.targets, dtype=np.float64).reshape(-1, 3),
        notes=notes,
        live=True,
    )
    return ViewerPage(server, content, timeline.buffer.timeline)


def _run(page: ViewerPage, timeline: LiveTimeline, begin_s: float) -> None:
    last_s = time.monotonic()
    while True:
        now_s = time.monotonic()
        timeline.sample(now_s - begin_s)
        page.update(now_s - last_s)
        last_s = now_s
        time.sleep(max(PERIOD_S - (time.monotonic() - now_s), 0.001))

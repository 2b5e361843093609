"""A page of a running node."""

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

from ik_node.robot.catalogue import robot_from
from ik_node.robot.joint_limits import motion_limits
from ik_node.robot.robot import Robot
from ik_node.ros.live_view.listener import ViewNode
from ik_node.ros.live_view.live_timeline import STALE_S, LiveFilm
from ik_node.settings.groups import Settings
from ik_node.viewer.open_run import look_of
from ik_node.viewer.page import Page, Subject

LONGEST_S = 1e6
"""Stands for "for ever": the executor hangs on an infinite deadline."""
PERIOD_S = 1.0 / 30.0
KEPT_S = 120.0
"""How far one can look back."""
NICE = 10


def view_live(
    watched: str,
    make_server: Callable[[], Any],
    ready: Callable[[Any], None],
    arguments: Sequence[str] = (),
    timeout_s: float = 10.0,
) -> None:
    """Shows a running node until KeyboardInterrupt. ``ready`` is called with the server once the page is there.

    ``arguments``: for ROS. Raises IkNodeError when no node of that name answers within ``timeout_s``, or its robot is
    not known here.
    """
    # The arm goes before its picture.
    os.nice(NICE)
    rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    executor, over = EventsExecutor(), Future()
    node = ViewNode(watched if watched.startswith("/") else f"/{watched}")
    executor.add_node(node)
    listening = threading.Thread(target=_listen, args=(executor, over), daemon=True)
    listening.start()
    try:
        settings = node.ask_settings(timeout_s)
        robot = _robot(node, settings, timeout_s)
        server = make_server()
        try:
            film = LiveFilm(node, robot, settings, round(KEPT_S / PERIOD_S))
            begin_s = time.monotonic()
            _wait_for_arm(film, begin_s)
            page = _page(server, node, film, settings)
            film.reel.clear()
            ready(server)
            _keep_going(page, film, begin_s)
        finally:
            server.stop()
    finally:
        over.set_result(None)
        listening.join(2.0)
        executor.shutdown(0.5)
        node.destroy_node()
        rclpy.try_shutdown()


def _listen(executor: Any, over: Future) -> None:
    with contextlib.suppress(ExternalShutdownException):
        executor.spin_until_future_complete(over, LONGEST_S)


def _robot(node: ViewNode, settings: Settings, timeout_s: float) -> Robot:
    """The robot that the watched node has; waits for its description where it comes by topic."""
    until = time.monotonic() + timeout_s
    known = settings.arm.robot or settings.arm.robot_description
    while not known and not node.described and time.monotonic() < until:
        time.sleep(0.05)
    return robot_from(settings.arm, node.described)


def _wait_for_arm(film: LiveFilm, begin_s: float) -> None:
    """Until joint states have come, so that the camera finds the arm; not for long."""
    while not film.placed and time.monotonic() - begin_s < STALE_S:
        film.shoot(time.monotonic() - begin_s)
        time.sleep(PERIOD_S)


def _page(server: Any, node: ViewNode, film: LiveFilm, settings: Settings) -> Page:
    robot = film.robot
    parts, notes = look_of(robot, settings.obstacles.package_path)
    subject = Subject(
        title=f"{settings.arm.robot or robot.tip_frame}, live from {node.watched}",
        robot=robot,
        parts=parts,
        velocity_limits=motion_limits(robot, settings.limits, settings.control.rate_hz).velocity,
        mass_weighted=settings.control.method != "plain",
        scene_at=film.scenes,
        targets=lambda: np.array(film.targets, dtype=np.float64).reshape(-1, 3),
        notes=notes,
        live=True,
    )
    return Page(server, subject, film.reel.film)


def _keep_going(page: Page, film: LiveFilm, begin_s: float) -> None:
    last_s = time.monotonic()
    while True:
        now_s = time.monotonic()
        film.shoot(now_s - begin_s)
        page.tick(now_s - last_s)
        last_s = now_s
        time.sleep(max(PERIOD_S - (time.monotonic() - now_s), 0.001))

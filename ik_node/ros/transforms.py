"""Poses of frames outside the robot model, from tf. Needs tf2_ros, which is part of ROS but not on PyPI."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from typing import Any

from rclpy.time import Time

from ik_node.errors import IkNodeError, TargetRefused
from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.samples import frames_of, stamp_of
from ik_node.messages.step_codec import CallKind
from ik_node.replay.recorded_controller import RecordedController
from ik_node.robot.frames import transform_text
from ik_node.ros.throttled_log import ThrottledLog

MAX_AGE_S = 0.5
"""Largest age of a transform: a broadcaster at 10 Hz may miss four; an arm at 1 m/s is at most 0.5 m off by then."""


class TransformRefused(TargetRefused):
    """The transform of a frame is too old."""


class Transforms:
    """Looks frames up in tf; yields nothing without tf2_ros or where tf does not connect a frame."""

    def __init__(self, node: Any, tf2_ros: Any = None) -> None:
        self._buffer: Any = None
        self._log = ThrottledLog(node)
        self._last: dict[str, str] = {}
        try:
            tf2_ros = tf2_ros or importlib.import_module("tf2_ros")
        except ImportError:
            return
        self._failure = tf2_ros.TransformException
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def pass_frames(self, calls: RecordedController, sample: object, now: Instant) -> bool:
        """Pass poses from tf to the controller, of frames of a sample that are not in the robot model.

        Args:
            calls: The controller.
            sample: A decoded input.
            now: Time of its arrival.

        Returns:
            Whether the sample has such frames.

        Raises:
            TransformRefused: A transform is too old.
        """
        robot, frames = calls.controller.robot, frames_of(sample)
        if "" in frames:
            text = f"frame_id is empty; the base frame '{robot.base_frame}' is used"
            self._log.warning_once("frame_id", text)
        unknown = [frame for frame in frames if frame and frame not in robot.frames]
        for transform in self.lookup(robot.base_frame, unknown, stamp_of(sample), now.ros_ns):
            try:
                calls.call(CallKind.ON_TRANSFORM, now, transform)
            except IkNodeError as error:
                self._log.warning("tf", f"transform refused: {error}")
        return bool(unknown)

    def lookup(self, base: str, frames: Iterable[str], stamp_ns: int, now_ns: int) -> Iterator[str]:
        """Yield the pose of each of ``frames`` in ``base`` that has changed since the last call.

        Args:
            base: Base frame.
            frames: Frames that are not in the robot model.
            stamp_ns: Stamp of the sample, ROS time, at which the transform is wanted; 0: the newest. Where tf has none
                at the stamp, the newest one is taken.
            now_ns: Present ROS time.

        Yields:
            Texts made by :func:`ik_node.robot.frames.transform_text`.

        Raises:
            TransformRefused: The transform is older than :data:`MAX_AGE_S`.
        """
        if self._buffer is None:
            return
        for frame in frames:
            found = self._at(base, frame, stamp_ns)
            if found is None:
                continue  # the controller refuses the frame and lists the known ones
            stamp = found.header.stamp
            taken_ns = NS * stamp.sec + stamp.nanosec
            if taken_ns and now_ns - taken_ns > MAX_AGE_S * NS:  # a static transform has stamp 0
                # without the age, so that the status of a stream of targets does not change with each one
                raise TransformRefused(f"transform from {frame} to {base} is older than {MAX_AGE_S:g} s")
            position, rotation = found.transform.translation, found.transform.rotation
            quaternion = (rotation.x, rotation.y, rotation.z, rotation.w)
            text = transform_text(frame, (position.x, position.y, position.z), quaternion)
            if self._last.get(frame) != text:
                self._last[frame] = text
                yield text

    def _at(self, base: str, frame: str, stamp_ns: int) -> Any:
        """Return the transform at a stamp, else the newest; None when tf has neither."""
        for time in (Time(nanoseconds=stamp_ns), Time()) if stamp_ns > 0 else (Time(),):
            try:
                return self._buffer.lookup_transform(base, frame, time)
            except self._failure:
                continue
        return None

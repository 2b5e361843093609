"""Poses of frames outside the robot model, from tf. Needs tf2_ros, which is part of ROS but not on PyPI."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from typing import Any

from rclpy.time import Time

from ik_node.robot.frames import transform_text


class Transforms:
    """Looks frames up in tf; yields nothing without tf2_ros or where tf does not connect a frame."""

    def __init__(self, node: Any) -> None:
        self._buffer: Any = None
        try:
            tf2_ros = importlib.import_module("tf2_ros")
        except ImportError:
            return
        self._failure = tf2_ros.TransformException
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)
        self._last: dict[str, str] = {}

    def lookup(self, base: str, frames: Iterable[str]) -> Iterator[str]:
        """Yield the newest pose of each of ``frames`` in ``base`` that has changed since the last call.

        A pose is a text made by :func:`ik_node.robot.frames.transform_text`.
        """
        if self._buffer is None:
            return
        for frame in frames:
            try:
                transform = self._buffer.lookup_transform(base, frame, Time()).transform
            except self._failure:
                continue  # the controller refuses the frame and lists the known ones
            position, rotation = transform.translation, transform.rotation
            quaternion = (rotation.x, rotation.y, rotation.z, rotation.w)
            text = transform_text(frame, (position.x, position.y, position.z), quaternion)
            if self._last.get(frame) != text:
                self._last[frame] = text
                yield text

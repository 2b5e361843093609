"""Answers of tf: where frames outside the robot's model are. Used where tf2_ros can be imported; it is not on PyPI."""

from __future__ import annotations

import importlib
from collections.abc import Iterable, Iterator
from typing import Any

from rclpy.time import Time

from ik_node.robot.frames import answer_text


class Transforms:
    """Asks tf for frames; without tf2_ros, or where tf connects nothing, there are no answers."""

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

    def answers(self, base: str, frames: Iterable[str]) -> Iterator[str]:
        """The newest place of each of ``frames`` in ``base`` where it is new, as :func:`ik_node.robot.frames.answer_text`."""
        if self._buffer is None:
            return
        for frame in frames:
            try:
                found = self._buffer.lookup_transform(base, frame, Time()).transform
            except self._failure:
                continue  # the controller refuses the frame, and lists those that there are
            place, turn = found.translation, found.rotation
            text = answer_text(frame, (place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
            if self._last.get(frame) != text:
                self._last[frame] = text
                yield text

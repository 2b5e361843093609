"""Transforms of tf at the stamp of a sample, of bounded age; tf is played by the test."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2: requirements.txt has the wheels")

from ik_node.ros.transforms import TransformRefused, Transforms  # noqa: E402

S = 1_000_000_000


class Missing(Exception):
    pass


class Buffer:
    """Has transforms at whole seconds up to 10 s; x is the second."""

    static = False

    def lookup_transform(self, base: str, frame: str, time: Any) -> Any:
        if frame != "camera":
            raise Missing
        if time.nanoseconds > 10 * S:
            raise Missing
        seconds = time.nanoseconds // S or 10
        stamp = SimpleNamespace(sec=0 if self.static else seconds, nanosec=0)
        transform = SimpleNamespace(
            translation=SimpleNamespace(x=float(seconds), y=0.0, z=0.0),
            rotation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0),
        )
        return SimpleNamespace(header=SimpleNamespace(stamp=stamp), transform=transform)


def transforms(static: bool = False) -> Transforms:
    kind = type("Buffer", (Buffer,), {"static": static})
    module = SimpleNamespace(TransformException=Missing, Buffer=kind, TransformListener=lambda buffer, node: None)
    return Transforms(None, module)


def test_the_transform_at_the_stamp_is_taken_else_the_newest() -> None:
    tf = transforms()
    (at,) = tf.lookup("base", ["camera"], 9 * S, 9 * S + S // 4)
    assert at.startswith("camera 9.0 ")
    (newest,) = tf.lookup("base", ["camera"], 10 * S + S // 4, 10 * S + S // 4)
    assert newest.startswith("camera 10.0 ")
    assert list(tf.lookup("base", ["camera"], 0, 10 * S)) == [], "unchanged"
    assert list(tf.lookup("base", ["kitchen"], 0, 10 * S)) == []


def test_an_old_transform_is_refused_with_its_age() -> None:
    for stamp_ns in (0, 28 * S):
        with pytest.raises(TransformRefused, match=r"^transform from camera to base is 18.2 s old; at most 0.5 s$"):
            list(transforms().lookup("base", ["camera"], stamp_ns, 28 * S + S // 5))


def test_a_static_transform_has_no_age() -> None:
    assert len(list(transforms(static=True).lookup("base", ["camera"], 0, 28 * S))) == 1

"""Bounds of the inputs: lengths are read before anything is decoded, and what exceeds one is refused in a line."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ik_node.errors import InputError
from ik_node.interfaces.samples import MAX_POSES
from ik_node.messages import decode, decode_obstacles, decode_targets
from ik_node.messages.cdr import STORE, deserialize, header, make, serialize
from ik_node.messages.decode_obstacles import MAX_MARKERS
from ik_node.messages.encode import encode_command, encode_joint_state, encode_pose

FAST_S = 0.005
"""CPU time within which every message above its bound has to be refused; 2.9 s before there were bounds."""
MARKERS = decode_obstacles.MARKERS_TYPE


def marker(kind: int = 2, action: int = 0, ns: str = "shelf", number: int = -3, extra: int = 2) -> Any:
    point = make("geometry_msgs/msg/Point", x=0.1, y=0.2, z=0.3)
    colour = make("std_msgs/msg/ColorRGBA", r=1.0, g=0.0, b=0.0, a=1.0)
    data = np.arange(extra * 3, dtype=np.uint8)
    return make(
        "visualization_msgs/msg/Marker",
        header=header("base", 5),
        ns=ns,
        id=number,
        type=kind,
        action=action,
        pose=make(
            "geometry_msgs/msg/Pose",
            position=point,
            orientation=make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.6, w=0.8),
        ),
        scale=make("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=0.3),
        color=colour,
        lifetime=make("builtin_interfaces/msg/Duration", sec=1, nanosec=5),
        frame_locked=True,
        points=[point] * extra,
        colors=[colour] * extra,
        texture_resource="t" * extra,
        texture=make("sensor_msgs/msg/CompressedImage", header=header("x" * extra), format="p" * extra, data=data),
        uv_coordinates=[make("visualization_msgs/msg/UVCoordinate", u=0.5, v=1.0)] * extra,
        text="t" * (extra + 1),
        mesh_resource="m" * extra,
        mesh_file=make("visualization_msgs/msg/MeshFile", filename="f" * extra, data=data),
        mesh_use_embedded_materials=True,
    )


@pytest.mark.parametrize("extra", [0, 1, 2, 3, 5, 8])
def test_markers_with_drawings_of_every_length_are_read(extra: int) -> None:
    """Fields that are no obstacle are skipped: the next marker is read at the right place, in both byte orders."""
    message = make(MARKERS, markers=[marker(extra=extra), marker(3, 2, "", 7, extra + 1), marker(5, 3, "n" * extra)])
    for little in (True, False):
        first, second, third = decode_obstacles.decode_obstacles(
            bytes(STORE.serialize_cdr(message, MARKERS, little_endian=little))
        )
        assert (first.name, first.kind, first.size, first.action) == ("shelf/-3", "sphere", (0.15,), "add")
        assert (first.frame_id, first.stamp_ns, first.lifetime_ns) == ("base", 5, 1_000_000_005)
        assert first.position.tolist() == [0.1, 0.2, 0.3]
        assert first.quaternion.tolist() == [0.0, 0.0, 0.6, 0.8]
        assert (second.name, second.kind, second.size, second.action) == ("/7", "cylinder", (0.1, 0.3), "delete")
        assert (third.name, third.kind, third.action) == (f"{'n' * extra}/-3", "LINE_LIST", "delete_all")


@pytest.mark.parametrize(("kind", "name"), [(0, "ARROW"), (9, "TEXT_VIEW_FACING"), (10, "MESH_RESOURCE"), (77, "77")])
def test_unsupported_markers_are_named(kind: int, name: str) -> None:
    (sample,) = decode_obstacles.decode_obstacles(serialize(make(MARKERS, markers=[marker(kind)])))
    assert name in sample.kind


def path_bytes(count: int) -> bytes:
    stamped = deserialize(encode_pose("", 5, np.ones(3), np.ones(4)), decode_targets.POSE_TYPE)
    data = serialize(make(decode_targets.PATH_TYPE, header=header("base"), poses=[stamped] * 2))
    return data[: data.index(b"base\0") + 8] + count.to_bytes(4, "little") + data[-72:] * count


def trajectory_bytes(count: int) -> bytes:
    data = serialize(make(decode_targets.TRAJECTORY_TYPE, header=header("base"), joint_names=["tool"], points=[]))
    return data[:-4] + count.to_bytes(4, "little") + bytes(72 * count)


def names_bytes(count: int) -> bytes:
    return encode_joint_state(tuple(f"j{index}" for index in range(count)), 0, np.zeros(count))


CASES: list[tuple[str, Callable[[bytes], Any], Callable[[], bytes], str]] = [
    ("path", decode_targets.decode_path, lambda: path_bytes(100_000), "100000 poses; at most 2000 are accepted"),
    ("poses", decode_targets.decode_path, lambda: path_bytes(MAX_POSES + 1), "2001 poses; at most 2000 are accepted"),
    ("points", decode_targets.decode_trajectory, lambda: trajectory_bytes(MAX_POSES + 1), "2001 points; at most 2000"),
    ("trajectory", decode_targets.decode_trajectory, lambda: trajectory_bytes(100_000), "100000 points; at most"),
    (
        "markers",
        decode_obstacles.decode_obstacles,
        lambda: serialize(make(MARKERS, markers=[marker()] * (MAX_MARKERS + 1))),
        f"{MAX_MARKERS + 1} markers; at most {MAX_MARKERS} are accepted",
    ),
    (
        "many markers",
        decode_obstacles.decode_obstacles,
        lambda: serialize(make(MARKERS, markers=[marker()] * 10_000)),
        "10000 markers; at most",
    ),
    ("names", decode.decode_joint_state, lambda: names_bytes(257), "257 joint names; at most 256 are accepted"),
    ("many names", decode.decode_joint_state, lambda: names_bytes(100_000), "100000 joint names; at most"),
    ("command", decode.decode_command, lambda: encode_command(np.zeros(300)), "300 numbers; at most 256 are accepted"),
    (
        "large markers",
        decode_obstacles.decode_obstacles,
        lambda: serialize(make(MARKERS, markers=[marker(extra=1000)] * 25)),
        "bytes; at most 1000000 are accepted",
    ),
    (
        "frame",
        decode_targets.decode_pose,
        lambda: encode_pose("f" * 10**7, 0, np.zeros(3), np.ones(4)),
        "bytes; at most 4096 are accepted",
    ),
]


@pytest.mark.parametrize(("decoder", "data", "reason"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_what_exceeds_a_bound_is_refused_undecoded(
    decoder: Callable[[bytes], Any], data: Callable[[], bytes], reason: str
) -> None:
    message = data()
    start_s = time.process_time()
    with pytest.raises(InputError, match=reason) as caught:
        decoder(message)
    assert time.process_time() - start_s < FAST_S
    assert "\n" not in str(caught.value)


def test_messages_at_their_bounds_are_accepted() -> None:
    assert len(decode_targets.decode_path(path_bytes(MAX_POSES)).stamps_ns) == MAX_POSES
    assert len(decode.decode_joint_state(names_bytes(256)).names) == 256
    markers = decode_obstacles.decode_obstacles(serialize(make(MARKERS, markers=[marker()] * MAX_MARKERS)))
    assert len(markers) == MAX_MARKERS


@pytest.mark.parametrize("count", [2**31, 2**32 - 1])
def test_a_count_beyond_the_message_is_refused(count: int) -> None:
    """Counts of sequences that are skipped as well: nothing of that size is allocated."""
    data = serialize(make(MARKERS, markers=[marker()]))
    for offset in range(0, len(data) - 4, 4):
        damaged = data[:offset] + count.to_bytes(4, "little") + data[offset + 4 :]
        try:
            decode_obstacles.decode_obstacles(damaged)
        except InputError:
            continue

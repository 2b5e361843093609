"""Decoding of paths, trajectories and twists: every message that the typestore can write is decoded to the same
numbers.

Covered: both byte orders, strings of every length (alignment), empty and invalid messages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ik_node.errors import InputError
from ik_node.interfaces.clock import NS
from ik_node.messages.cdr import STORE, header, make, serialize
from ik_node.messages.decode_targets import (
    PATH_TYPE,
    TRAJECTORY_TYPE,
    TWIST_TYPE,
    decode_path,
    decode_trajectory,
    decode_twist,
)


def point(values: Any) -> Any:
    return make("geometry_msgs/msg/Point", x=values[0], y=values[1], z=values[2])


def vector(values: Any) -> Any:
    return make("geometry_msgs/msg/Vector3", x=values[0], y=values[1], z=values[2])


def quaternion(values: Any) -> Any:
    return make("geometry_msgs/msg/Quaternion", x=values[0], y=values[1], z=values[2], w=values[3])


def path_message(frames: list[str], frame_id: str, numbers: Any) -> Any:
    poses = [
        make(
            "geometry_msgs/msg/PoseStamped",
            header=header(frame, 1_700_000_000 * NS + index),
            pose=make("geometry_msgs/msg/Pose", position=point(row[:3]), orientation=quaternion(row[3:])),
        )
        for index, (frame, row) in enumerate(zip(frames, numbers.tolist(), strict=True))
    ]
    return make(PATH_TYPE, header=header(frame_id, 5), poses=poses)


def twist(values: Any) -> Any:
    return make("geometry_msgs/msg/Twist", linear=vector(values[:3]), angular=vector(values[3:]))


def trajectory_message(
    frame_id: str, numbers: Any, counts: tuple[int, int, int], names: tuple[str, ...] = ("tool",)
) -> Any:
    points = [
        make(
            "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
            transforms=[make("geometry_msgs/msg/Transform", translation=vector(row[:3]), rotation=quaternion(row[3:7]))]
            * counts[0],
            velocities=[twist(row[7:13])] * counts[1],
            accelerations=[twist(row[13:])] * counts[2],
            time_from_start=make("builtin_interfaces/msg/Duration", sec=index, nanosec=7),
        )
        for index, row in enumerate(numbers.tolist())
    ]
    return make(TRAJECTORY_TYPE, header=header(frame_id, 3 * NS), joint_names=list(names), points=points)


def both_orders(message: Any) -> tuple[bytes, bytes]:
    big = bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=False))
    return serialize(message), big


@pytest.mark.parametrize("length", range(9))
def test_paths(length: int) -> None:
    numbers = np.random.default_rng(length).normal(size=(5, 7))
    frames = ["f" * length, "", "base", "f" * (length + 1), "world"]
    for data in both_orders(path_message(frames, "own", numbers)):
        sample = decode_path(data)
        assert sample.frame_ids == tuple(frame or "own" for frame in frames)
        assert sample.stamp_ns == 5
        assert sample.stamps_ns == tuple(1_700_000_000 * NS + index for index in range(5))
        assert np.array_equal(sample.positions, numbers[:, :3])
        assert np.array_equal(sample.quaternions, numbers[:, 3:])


@pytest.mark.parametrize("counts", [(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)])
def test_trajectories(counts: tuple[int, int, int]) -> None:
    for length in range(9):
        numbers = np.random.default_rng(length).normal(size=(4, 19))
        for data in both_orders(trajectory_message("f" * length, numbers, counts, ("tool", "x" * length))):
            sample = decode_trajectory(data)
            assert sample.frame_id == "f" * length
            assert sample.stamp_ns == 3 * NS
            assert sample.times_ns == tuple(index * NS + 7 for index in range(4))
            assert np.array_equal(sample.positions, numbers[:, :3])
            assert np.array_equal(sample.quaternions, numbers[:, 3:7])
            assert np.array_equal(sample.twists, numbers[:, 7:13] if counts[1] else np.empty((0, 6)))
            assert np.array_equal(sample.accelerations, numbers[:, 13:] if counts[2] else np.empty((0, 6)))


def test_twists() -> None:
    numbers = np.random.default_rng(1).normal(size=6)
    for length in range(9):
        message = make(TWIST_TYPE, header=header("f" * length, 9 * NS + 1), twist=twist(numbers.tolist()))
        for data in both_orders(message):
            sample = decode_twist(data)
            assert (sample.stamp_ns, sample.frame_id) == (9 * NS + 1, "f" * length)
            assert np.array_equal(sample.twist, numbers)


def test_empty_messages_are_no_error_here() -> None:
    for data in both_orders(path_message([], "base", np.empty((0, 7)))):
        assert decode_path(data).positions.shape == (0, 3)
    for data in both_orders(trajectory_message("base", np.empty((0, 19)), (1, 1, 1), ())):
        sample = decode_trajectory(data)
        assert sample.times_ns == ()
        assert sample.twists.shape == (0, 6)


@pytest.mark.parametrize(
    ("counts", "reason"),
    [
        ((0, 0, 0), "point 0 has 0 transforms; expected 1"),
        ((2, 0, 0), "point 0 has 2 transforms"),
        ((1, 2, 0), "2 velo"),
    ],
)
def test_points_that_have_no_place_are_named(counts: tuple[int, int, int], reason: str) -> None:
    for data in both_orders(trajectory_message("base", np.zeros((2, 19)), counts)):
        with pytest.raises(InputError, match=reason):
            decode_trajectory(data)


def test_velocities_of_some_points_only_are_named() -> None:
    message = trajectory_message("base", np.zeros((3, 19)), (1, 1, 0))
    message.points[2].velocities = []
    for data in both_orders(message):
        with pytest.raises(InputError, match="point 2 has 0 velocities; expected 1, as in point 0"):
            decode_trajectory(data)


MESSAGES: list[tuple[Callable[[bytes], object], Any]] = [
    (decode_path, path_message(["base"] * 3, "base", np.ones((3, 7)))),
    (decode_trajectory, trajectory_message("base", np.ones((3, 19)), (1, 1, 1))),
    (decode_twist, make(TWIST_TYPE, header=header("base"), twist=twist([0.0] * 6))),
]


@pytest.mark.parametrize(("decode", "message"), MESSAGES)
def test_broken_bytes_are_an_input_error(decode: Callable[[bytes], object], message: Any) -> None:
    generator = np.random.default_rng(3)
    for data in both_orders(message):
        for end in range(0, len(data) - 8):
            with pytest.raises(InputError):
                decode(data[:end])
        for _ in range(300):
            broken = bytearray(data)
            for place in generator.integers(4, len(data), size=3).tolist():
                broken[place] = int(generator.integers(256))
            try:
                decode(bytes(broken))
            except InputError:
                continue

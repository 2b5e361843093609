"""Synthetic steps and runs: every field is set, including special values."""

from __future__ import annotations

from typing import Any

import numpy as np

from ik_node.interfaces.clock import NS, Instant
from ik_node.interfaces.step import Level, Mode, Status, Step
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.robot import Robot
from ik_node.settings.groups import ArmSettings

ROS_START_NS = 1_700_000_000_123_456_789
TRACKING = Status(Level.OK, Mode.TRACKING, "following target_pose")
STOPPED = Status(Level.ERROR, Mode.STOPPED, "no joint state for 0.1 s: überprüfen")


def made_step(tick: int, n: int, seed: int = 0, period_ns: int = 2_000_000) -> Step:
    """Return a Step of random numbers; the same arguments give the same bits."""
    rng = np.random.default_rng((seed, tick, n))
    monotonic_ns = 3 * NS + 7 + tick * period_ns
    twists = [rng.normal(size=6) for _ in range(5)]
    twists[3][:] = -0.0
    binding = ("velocity panda_joint4", "position panda_joint2") if tick % 5 == 3 else ()
    return Step(
        tick=tick,
        now=Instant(monotonic_ns, ROS_START_NS + tick * period_ns),
        state_time_ns=monotonic_ns - 123_457,
        joint_position=rng.normal(size=n),
        joint_velocity=rng.normal(size=n) * 1e-3,
        pose_sb=se3.exp(rng.normal(size=6)),
        pose_sd=se3.exp(rng.normal(size=6)),
        error_b=twists[0],
        feedforward_b=twists[1],
        twist_b=twists[2],
        truncated_b=twists[3],
        off_direction_b=twists[4],
        scale=float(rng.uniform()),
        multiplier_task=rng.normal(size=6),
        multiplier_potential=np.full(6, 5e-324),
        singular_values=np.sort(rng.uniform(size=min(6, n)))[::-1].copy(),
        binding=binding,
        off_direction_limits=binding[:1],
        clearance=float(rng.uniform()) if tick % 2 else float("nan"),
        progress=float(rng.uniform()),
        path_distance=float("nan"),
        closest_points=rng.normal(size=(2, 3)),
        closest_pair=("panda_link5", "post") if tick % 7 == 2 else (),
        status=TRACKING,
    )


def stopped_step(tick: int, n: int) -> Step:
    """Return a Step of a stopped control step: zero commands, nothing computed."""
    step = made_step(tick, n)
    nan = float("nan")
    nothing: dict[str, Any] = {
        name: np.full_like(value, nan)
        for name, value in step._asdict().items()
        if isinstance(value, np.ndarray) and name not in ("joint_position", "joint_velocity")
    }
    return step._replace(
        joint_velocity=np.zeros(n),
        scale=nan,
        clearance=nan,
        status=STOPPED,
        binding=(),
        off_direction_limits=(),
        **nothing,
    )


def same_bits(first: object, second: object) -> bool:
    """True if equal to the last bit: NaN equals NaN, -0.0 differs from 0.0."""
    if isinstance(first, tuple) and isinstance(second, tuple):
        return len(first) == len(second) and all(map(same_bits, first, second))
    if isinstance(first, (np.ndarray, float)) and isinstance(second, (np.ndarray, float)):
        one, two = np.asarray(first), np.asarray(second)
        return one.dtype == two.dtype and one.shape == two.shape and one.tobytes() == two.tobytes()
    return type(first) is type(second) and first == second


def panda() -> Robot:
    """The arm of most tests."""
    return catalogue.robot_from_settings(ArmSettings(robot="panda"))


def steps(count: int, n: int = 7) -> list[Step]:
    """Return the Steps of a run; a few in the middle are stopped."""
    return [
        stopped_step(tick, n) if count // 2 <= tick < count // 2 + 3 else made_step(tick, n) for tick in range(count)
    ]


def quaternion_of(pose: Array) -> Array:
    """x, y, z, w."""
    return se3.quaternion_from_rotation(pose[:3, :3])

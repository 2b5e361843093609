"""Runs of a task with a tolerance: a target that moves in what is followed, and beside it anyhow in what is free."""

from __future__ import annotations

from collections.abc import Callable
from math import inf

import numpy as np
from loop import READY, Loop, make_robot
from scipy.spatial.transform import Rotation

from ik_node.interfaces.clock import NS
from ik_node.interfaces.samples import PathSample, TrajectorySample, TwistSample
from ik_node.math import se3
from ik_node.math.types import Array
from ik_node.settings.groups import Settings

Free = Callable[[float], Array]
"""Time, s -> motion in what is free: x y z, m, and a rotation vector, rad, in the axes of the tolerance."""
POINTING = (0.0, 0.0, 0.0, 0.0, 0.0, inf)
BAND = (0.0, 0.0, 0.0, 0.2, 0.2, 0.2)
POSITION = (0.0, 0.0, 0.0, inf, inf, inf)


def task_loop(robot: str, tolerance: tuple[float, ...], frame: str = "tool", **values: object) -> Loop:
    """A loop of an arm with a tolerance, ready for targets."""
    named = {name.replace("__", "."): value for name, value in values.items()}
    settings = Settings().with_values({"task.tolerance": tolerance, "task.frame": frame, **named})
    loop = Loop(make_robot(robot), READY[robot], settings)
    loop.run(0.01)
    return loop


def nothing(time_s: float) -> Array:
    return np.zeros(6)


def target_of(start: Array, frame: str, free: Free) -> Callable[[float], Array]:
    """Time, s -> T_sd: 0.1 m and 0.4 rad in half a second, beside a motion in what is free."""

    def pose(time_s: float) -> Array:
        moved: Array = start.copy()
        beside = free(time_s)
        moved[:3, :3] = Rotation.from_rotvec((0.4 * np.sin(2.0 * time_s), 0.3 * time_s, 0.2 * time_s)).as_matrix()
        moved[:3, :3] = moved[:3, :3] @ start[:3, :3]
        moved[:3, 3] += (0.1 * np.sin(3.0 * time_s), 0.1 * time_s, -0.05 * time_s)
        turn = Rotation.from_rotvec(beside[3:]).as_matrix()
        if frame == "base":
            moved[:3, :3], moved[:3, 3] = turn @ moved[:3, :3], moved[:3, 3] + beside[:3]
        else:
            moved[:3, 3] += moved[:3, :3] @ beside[:3]
            moved[:3, :3] = moved[:3, :3] @ turn
        return moved

    return pose


def send_path(loop: Loop, pose: Callable[[float], Array], timed: bool) -> None:
    times = np.linspace(0.0, 0.5, 26)
    poses = [pose(float(time_s)) for time_s in times]
    base, begin_ns = loop.robot.base_frame, loop.now.ros_ns
    stamps = tuple(begin_ns + round(time_s * NS) if timed else 0 for time_s in times.tolist())
    loop.controller.on_target_path(
        PathSample((base,) * len(poses), stamps, np.array([one[:3, 3] for one in poses]), quaternions(poses)), loop.now
    )


def send_trajectory(loop: Loop, pose: Callable[[float], Array]) -> None:
    """With twists by central differences of the poses."""
    times, step = np.linspace(0.0, 0.5, 26), 1e-6
    poses = [pose(float(time_s)) for time_s in times]
    twists = []
    for time_s in times.tolist():
        before, after = pose(time_s - step), pose(time_s + step)
        turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
        twists.append(np.concatenate((after[:3, 3] - before[:3, 3], turn)) / (2.0 * step))
    times_ns = tuple(round(time_s * NS) for time_s in times.tolist())
    positions = np.array([one[:3, 3] for one in poses])
    sample = TrajectorySample(
        loop.now.ros_ns,
        loop.robot.base_frame,
        times_ns,
        positions,
        quaternions(poses),
        np.array(twists),
        np.empty((0, 6)),
    )
    loop.controller.on_target_trajectory(sample, loop.now)


def jog(loop: Loop, duration_s: float, twist: Callable[[float], Array], frame: str) -> None:
    """Sends a twist every 20 ms."""
    for number in range(round(duration_s / 0.02)):
        loop.controller.on_target_twist(TwistSample(0, frame, twist(0.02 * number)), loop.now)
        loop.run(0.02)


def quaternions(poses: list[Array]) -> Array:
    return np.array([se3.quaternion_from_rotation(one[:3, :3]) for one in poses])


def commands(loop: Loop) -> Array:
    return np.array([step.joint_velocity for step in loop.steps])

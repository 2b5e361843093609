"""Bands at their borders, in the control loop: a target that the arm can follow never takes the tool out of a band.

Random tasks; the target swings through the bands and beyond them, as fast as the joints can follow with the whole pose.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi

import numpy as np
import pytest
from loop import READY, Loop
from scipy.spatial.transform import Rotation
from task_loops import task_loop

from ik_node.math.task_error import excess, task_deviation
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array

EXACT = (0.0,) * 6
DURATION_S, RISE_S = 3.0, 1.0
ACCELERATION = {"panda": 4.0, "ur5": 10.0}
"""Of each joint, rad/s2: slow, so that the border is approached faster than gain times distance can brake."""


def random_task(rng: np.random.Generator) -> tuple[tuple[float, ...], str]:
    """One to three bands, at most one free rotation, the other components exact."""
    widths = np.zeros(6)
    bands = rng.choice(6, rng.integers(1, 4), replace=False)
    widths[bands] = rng.uniform(0.3, 1.0, len(bands)) * np.where(bands < 3, 0.02, 0.2)
    if rng.uniform() < 0.5:
        widths[5] = inf
    return tuple(widths.tolist()), str(rng.choice(["tool", "base"]))


def swinging(start: Array, rng: np.random.Generator) -> Callable[[float], Array]:
    """Time, s -> T_sd: all components swing about ``start``; the motion begins smoothly."""
    size = rng.uniform(0.7, 1.0, 6) * np.repeat((0.05, 0.45), 3)
    rate, phase = 2.0 * pi / rng.uniform(3.5, 4.5, 6), rng.uniform(-pi, pi, 6)

    def pose(time_s: float) -> Array:
        ratio = min(time_s / RISE_S, 1.0)
        rise = ratio * ratio * ratio * (10.0 - ratio * (15.0 - 6.0 * ratio))
        beside = rise * size * np.sin(rate * time_s + phase)
        moved: Array = start.copy()
        moved[:3, 3] += beside[:3]
        moved[:3, :3] = start[:3, :3] @ Rotation.from_rotvec(beside[3:]).as_matrix()
        return moved

    return pose


def run(robot: str, tolerance: tuple[float, ...], frame: str, seed: int) -> Loop:
    loop = task_loop(robot, tolerance, frame, limits__acceleration=(ACCELERATION[robot],))
    loop.follow(swinging(loop.pose(), np.random.default_rng(seed)), DURATION_S, 500.0)
    return loop


@pytest.mark.parametrize("robot", READY)
def test_no_band_is_exceeded_by_a_target_that_the_arm_can_follow(robot: str) -> None:
    at_border = 0
    for seed in range(4):
        tolerance, frame = random_task(np.random.default_rng(100 + seed))
        form = TaskTolerance(tolerance, frame).form
        assert min(step.scale for step in run(robot, EXACT, "tool", seed).steps[20:]) == 1.0
        steps = run(robot, tolerance, frame, seed).steps[20:]
        for step in steps:
            deviation = task_deviation(form, step.pose_sb, step.pose_sd).components
            over = np.abs(excess(deviation, form.half_widths))
            assert over.max() < 1e-4, (seed, tolerance, frame)
            at_border += any(name.startswith("band") for name in step.binding)
    assert at_border > 200

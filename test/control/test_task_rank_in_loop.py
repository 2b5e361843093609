"""An arm that cannot follow all exact components: status and proposal at configuration, the proposal is followed."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from loop import Loop, make_robot
from scipy.spatial.transform import Rotation

from ik_node.interfaces.step import Level
from ik_node.math.types import Array
from ik_node.settings.groups import Settings

START = {"so101": (0.0, -0.5, 0.6, 0.5, 0.0), "so100": (0.0, 1.8, -1.6, 0.6, 0.0)}
YAW_FREE = (0.0, 0.0, 0.0, 0.0, 0.0, inf)


def so_loop(name: str, **values: object) -> Loop:
    named = {key.replace("__", "."): value for key, value in values.items()}
    settings = Settings().with_values({"rate_hz": 100.0, "singularity.threshold": 0.02, **named})
    return Loop(make_robot(name), START[name], settings)


@pytest.mark.parametrize("name", START)
def test_a_task_of_higher_rank_than_the_arm_is_reported_with_a_proposal(name: str) -> None:
    loop = so_loop(name)
    loop.run(0.1)
    status = loop.controller.status
    assert status.level is Level.WARN
    assert "the arm can follow 5 of 6 exact components in general; rz in the frame base cannot" in status.reason
    assert "proposed tolerance: 0 0 0 0 0 inf in the frame base" in status.reason


@pytest.mark.parametrize("name", START)
def test_the_proposed_task_is_followed_without_a_warning(name: str) -> None:
    """A moving position, pitch and roll, with a target whose yaw the arm cannot reach."""
    loop = so_loop(name, task__tolerance=YAW_FREE, task__frame="base")
    start = loop.pose()

    def target(time_s: float) -> Array:
        moved: Array = start.copy()
        moved[:3, 3] += (0.02 * np.sin(time_s), 0.03 * np.sin(time_s), 0.02 * np.sin(time_s))
        moved[:3, :3] = Rotation.from_rotvec((0.0, 0.0, 1.0)).as_matrix() @ start[:3, :3]
        return moved

    loop.follow(target, 3.0, 50.0)
    status = loop.controller.status
    assert status.level is Level.OK, status.reason
    late = loop.steps[100:]
    assert max(float(np.linalg.norm(step.error_b[:3])) for step in late) < 1e-3
    assert max(float(np.linalg.norm(step.error_b[3:])) for step in late) < 5e-3
    assert all(step.scale == 1.0 for step in late)


def test_a_change_of_the_task_changes_the_report() -> None:
    loop = so_loop("so101")
    loop.run(0.1)
    loop.controller.apply(loop.settings.with_values({"task.tolerance": YAW_FREE, "task.frame": "base"}))
    loop.run(0.3)
    assert loop.controller.status.level is Level.OK
    loop.controller.apply(loop.settings.with_values({"task.tolerance": YAW_FREE}))
    loop.run(0.1)
    assert "the arm can follow 4 of 5 exact components in general" in loop.controller.status.reason


def test_an_arm_that_can_follow_its_task_says_nothing() -> None:
    loop = Loop(make_robot("ur5"), (0.0, -1.2, 1.6, -1.97, -1.57, 0.0))
    loop.run(0.05)
    assert "can follow" not in loop.controller.status.reason

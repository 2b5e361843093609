"""The member of a target that stands for its family: it belongs to it, is the nearest one, and is the same for all
targets of the family.

Targets of one family are made by rotation matrices in ``test_task_error``.
"""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_task_error import CASES, angle_between, error, pose, random_pose, same_families

from ik_node.math.quaternion import from_matrix, to_matrix
from ik_node.math.task_member import nearest_member, without_free_part
from ik_node.math.task_tolerance import TaskTolerance
from ik_node.math.types import Array

POINTING = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf))


def member(task: TaskTolerance, target: Array, near: Array) -> Array:
    position, orientation = nearest_member(
        task.form, tuple(target[:3, 3]), from_matrix(target), tuple(near[:3, 3]), from_matrix(near)
    )
    return pose(np.array(to_matrix(orientation)), np.array(position))


@pytest.mark.parametrize("task", CASES)
def test_the_member_belongs_to_the_family(task: TaskTolerance) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        target, near = random_pose(rng), random_pose(rng)
        assert np.abs(error(task, member(task, target, near), target)).max() < 1e-9


@pytest.mark.parametrize("task", CASES)
def test_targets_of_one_family_have_the_same_member(task: TaskTolerance) -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        target, near = random_pose(rng), random_pose(rng)
        first = member(task, target, near)
        for other in same_families(task, target, rng):
            assert np.abs(member(task, other, near) - first).max() < 1e-9


@pytest.mark.parametrize("task", CASES)
def test_a_member_that_is_the_reference_is_kept(task: TaskTolerance) -> None:
    rng = np.random.default_rng(3)
    for _ in range(10):
        target = random_pose(rng)
        assert np.abs(member(task, target, target) - target).max() < 1e-12


def test_the_member_is_the_nearest_one() -> None:
    rng = np.random.default_rng(6)
    for frame in ("tool", "base"):
        task = TaskTolerance((0.0, 0.0, inf, 0.0, 0.0, inf), frame)
        for _ in range(20):
            target, near = random_pose(rng), random_pose(rng)
            chosen = member(task, target, near)
            for other in same_families(task, target, rng):
                assert angle_between(chosen[:3, :3], near[:3, :3]) <= angle_between(other[:3, :3], near[:3, :3]) + 1e-9
                away = np.linalg.norm(other[:3, 3] - near[:3, 3])
                assert np.linalg.norm(chosen[:3, 3] - near[:3, 3]) <= away + 1e-9


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-7, 1e-3, 0.1])
def test_a_turned_over_axis_has_one_member_whatever_the_spin(tilt: float) -> None:
    """The axis of the target is opposite to that of the reference but for a small angle."""
    near = pose(np.eye(3), np.zeros(3))
    over = Rotation.from_rotvec((np.pi - tilt) * np.array((np.cos(0.4), np.sin(0.4), 0.0))).as_matrix()
    members = [
        member(POINTING, pose(over @ Rotation.from_rotvec((0.0, 0.0, spin)).as_matrix(), np.zeros(3)), near)
        for spin in np.linspace(0.0, 6.0, 25)
    ]
    assert max(np.abs(one - members[0]).max() for one in members) < 1e-9
    assert np.abs(members[0][:3, 2] - over[:, 2]).max() < 1e-9


@pytest.mark.parametrize("frame", ["tool", "base"])
def test_the_free_part_of_a_twist_is_what_moves_the_target_within_its_family(frame: str) -> None:
    """Moved by the removed part alone for a short time, a target stays in its family."""
    task, rng = TaskTolerance((0.0, 0.0, inf, 0.0, 0.0, inf), frame), np.random.default_rng(4)
    for _ in range(20):
        target, velocity, rate = random_pose(rng), rng.normal(size=3), rng.normal(size=3)
        kept = without_free_part(task.form, from_matrix(target), tuple(velocity), tuple(rate))
        removed_velocity, removed_rate = velocity - kept[0], rate - kept[1]
        moved = pose(
            Rotation.from_rotvec(1e-6 * removed_rate).as_matrix() @ target[:3, :3],
            target[:3, 3] + 1e-6 * removed_velocity,
        )
        assert np.linalg.norm(removed_rate) > 1e-3
        assert np.abs(error(task, target, moved)).max() < 1e-11
        again = without_free_part(task.form, from_matrix(target), *kept)
        assert np.abs(np.array(again) - np.array(kept)).max() < 1e-12

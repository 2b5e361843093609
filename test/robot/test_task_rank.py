"""Which components of a task an arm can follow in general, and the tolerance that is proposed."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from ik_node.math.task_tolerance import TaskTolerance
from ik_node.robot.catalogue import load_robot
from ik_node.robot.screw_chain import ScrewChain
from ik_node.robot.task_rank import FOLLOWED_M, task_rank

POSITION = TaskTolerance((0.0, 0.0, 0.0, inf, inf, inf))
POINTING = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf))
YAW_FREE = TaskTolerance((0.0, 0.0, 0.0, 0.0, 0.0, inf), "base")


@pytest.mark.parametrize("name", ["panda", "ur5", "kinova", "z1", "xarm7"])
@pytest.mark.parametrize("tolerance", [TaskTolerance(), POINTING, POSITION, YAW_FREE])
def test_six_and_seven_joints_follow_everything(name: str, tolerance: TaskTolerance) -> None:
    rank = task_rank(load_robot(name), tolerance)
    assert rank.followed
    assert rank.rank == rank.exact == tolerance.exact.sum()
    assert rank.singular_values[-1] > 5.0 * FOLLOWED_M
    assert (rank.proposal, rank.text(tolerance)) == (None, "")


@pytest.mark.parametrize("name", ["so100", "so101"])
def test_the_yaw_about_the_vertical_is_proposed_for_five_joints(name: str) -> None:
    arm = load_robot(name)
    rank = task_rank(arm, TaskTolerance())
    assert (rank.rank, rank.exact) == (5, 6)
    assert rank.proposal == YAW_FREE
    assert rank.text(TaskTolerance()) == (
        "the arm can follow 5 of 6 exact components in general; rz in the frame base cannot be followed beside the "
        "others; proposed tolerance: 0 0 0 0 0 inf in the frame base"
    )
    proposed = task_rank(arm, rank.proposal)
    assert proposed.followed
    assert proposed.singular_values[-1] == pytest.approx(0.04, abs=0.003)
    assert task_rank(arm, POSITION).followed


def test_pointing_has_rank_4_on_the_so101() -> None:
    # Its tool axis stays in the plane of the pan joint but for 8 mm beside the axis of the wrist.
    rank = task_rank(load_robot("so101"), POINTING)
    assert (rank.rank, rank.exact) == (4, 5)
    assert rank.singular_values[-1] == pytest.approx(0.003, abs=0.002)
    assert rank.proposal == YAW_FREE
    assert "4 of 5" in rank.text(POINTING)


@pytest.mark.parametrize(("name", "n"), [("finger_edu", 3), ("anymal", 3), ("allegro_left_hand", 4)])
def test_three_and_four_joints_keep_the_position(name: str, n: int) -> None:
    arm = load_robot(name)
    rank = task_rank(arm, TaskTolerance())
    assert (rank.rank, rank.exact) == (n, 6)
    assert rank.proposal is not None
    assert rank.proposal.exact[:3].all()
    assert rank.proposal.exact.sum() == n
    assert task_rank(arm, rank.proposal).followed


def test_a_planar_arm_keeps_what_lies_in_its_plane() -> None:
    # Three parallel axes along z: x, y and rz.
    home = np.eye(4)
    home[0, 3] = 3.0
    chain = ScrewChain.from_angular_first(home, space=[[0] * 3, [0] * 3, [1] * 3, [0] * 3, [0, -1, -2], [0] * 3])
    rank = task_rank(chain, TaskTolerance())
    assert rank.rank == 3
    assert rank.proposal is not None
    assert rank.proposal.exact.tolist() == [True, True, False, False, False, True]


def test_bands_are_kept_and_need_no_rank() -> None:
    band = TaskTolerance((0.0, 0.0, 0.0, 0.1, 0.0, 0.0), "base")
    rank = task_rank(load_robot("so101"), band)
    assert rank.exact == 5
    assert rank.proposal is None or rank.proposal.half_widths[3] == 0.1
    only_bands = task_rank(load_robot("so101"), TaskTolerance((0.1,) * 6))
    assert (only_bands.rank, only_bands.exact, only_bands.followed) == (0, 0, True)


def test_an_arm_that_can_follow_nothing_of_the_task_has_no_proposal() -> None:
    # One joint about z through the tool point; the task is its height.
    chain = ScrewChain(np.eye(4), [[0], [0], [0], [0], [0], [1]])
    height = TaskTolerance((inf, inf, 0.0, inf, inf, inf))
    rank = task_rank(chain, height)
    assert (rank.rank, rank.exact, rank.proposal) == (0, 1, None)
    assert rank.text(height) == "the arm can follow 0 of 1 exact components in general"

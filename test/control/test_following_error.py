"""Detection of a robot that does not follow, and snapshots of a monitor whose ring buffer grows and wraps around."""

from __future__ import annotations

import numpy as np
import pytest
from loop import make_robot

from ik_node.control.following_error import FollowingErrorMonitor, FollowingErrorSnapshot
from ik_node.recording.json_codec import from_json, to_json
from ik_node.settings.follow import FollowSettings

TICK_NS = 1_000_000


def monitor() -> FollowingErrorMonitor:
    return FollowingErrorMonitor(make_robot("panda"), FollowSettings())


@pytest.mark.parametrize(
    ("ratio", "text"), [(1.0, ""), (0.6, ""), (0.3, "less than commanded"), (0.0, "not move"), (-0.5, "by itself")]
)
def test_the_status_depends_on_the_ratio_of_measured_motion(ratio: float, text: str) -> None:
    watch, position, command = monitor(), np.zeros(7), np.full(7, 0.5)
    found = [watch.update(tick * TICK_NS, position + ratio * tick * 1e-3 * command, command) for tick in range(1000)]
    assert not any(found[:250]), "no status before the short window has passed"
    assert text in found[-1] and bool(found[-1]) == bool(text)


def test_motion_without_a_command_is_motion_by_itself() -> None:
    watch, drift = monitor(), np.full(7, 0.5)
    found = [watch.update(tick * TICK_NS, tick * 1e-3 * drift, np.zeros(7)) for tick in range(500)]
    assert "by itself" in found[-1]


@pytest.mark.parametrize(("ratio", "text"), [(0.3, "less than commanded"), (0.0, "not move"), (-0.5, "by itself")])
@pytest.mark.parametrize("joint", [0, 3])
def test_the_joint_that_does_not_follow_is_named(joint: int, ratio: float, text: str) -> None:
    """One joint is moved; the others have small commands, which they follow."""
    watch, command = monitor(), np.full(7, 0.05)
    command[joint] = 0.5
    factor = np.ones(7)
    factor[joint] = ratio
    reason = [watch.update(tick * TICK_NS, tick * 1e-3 * factor * command, command) for tick in range(1000)][-1]
    assert text in reason
    assert reason.endswith(f"; largest deviation at joint 'panda_joint{joint + 1}'")


def test_a_joint_that_moves_without_a_command_is_named() -> None:
    watch, drift = monitor(), np.zeros(7)
    drift[5] = -0.5
    found = [watch.update(tick * TICK_NS, tick * 1e-3 * drift, np.zeros(7)) for tick in range(2500)]
    assert "by itself" in found[-1]
    assert found[-1].endswith("largest deviation at joint 'panda_joint6'")


def test_small_commanded_motions_are_not_evaluated() -> None:
    watch, command = monitor(), np.full(7, 1e-3)
    assert not any(watch.update(tick * TICK_NS, np.zeros(7), command) for tick in range(5000))


@pytest.mark.parametrize("ticks", [0, 1, 255, 256, 257, 5000])
def test_a_restored_monitor_gives_the_same_bits(ticks: int) -> None:
    """Before, at and after the moments at which the ring buffer grows, and after it has wrapped around."""
    rng, first, second = np.random.default_rng(1), monitor(), monitor()
    steps = [(tick * TICK_NS, rng.normal(size=7), rng.normal(size=7)) for tick in range(ticks + 400)]
    for step in steps[:ticks]:
        first.update(*step)
    second.restore(from_json(to_json(first.capture()), FollowingErrorSnapshot))
    for step in steps[ticks:]:
        assert first.update(*step) == second.update(*step)
    assert to_json(first.capture()) == to_json(second.capture())
    kept = first.capture().times_ns
    assert (np.diff(kept) == TICK_NS).all()
    assert kept[-1] - kept[0] <= 2_001 * TICK_NS, "only the long window is kept"

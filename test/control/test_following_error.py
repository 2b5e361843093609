"""Whether an arm does what it is told: the verdicts, and the memory of a monitor whose ring of rows grows and turns."""

from __future__ import annotations

import numpy as np
import pytest
from loop import make_robot

from ik_node.control.following_error import FollowingErrorSnapshot, FollowMonitor
from ik_node.recording.json_codec import from_json, to_json
from ik_node.settings.groups import FollowSettings

TICK_NS = 1_000_000


def monitor() -> FollowMonitor:
    return FollowMonitor(make_robot("panda"), FollowSettings())


@pytest.mark.parametrize(("part", "words"), [(1.0, ""), (0.6, ""), (0.3, "less than it is told"), (0.0, "not move")])
def test_the_part_that_is_done_decides(part: float, words: str) -> None:
    watch, position, command = monitor(), np.zeros(7), np.full(7, 0.5)
    said = [watch.observe(tick * TICK_NS, position + part * tick * 1e-3 * command, command) for tick in range(1000)]
    assert not any(said[:250]), "nothing is judged before the window has passed"
    assert words in said[-1] and bool(said[-1]) == bool(words)


def test_nothing_is_judged_before_enough_was_asked() -> None:
    watch, command = monitor(), np.full(7, 1e-3)
    assert not any(watch.observe(tick * TICK_NS, np.zeros(7), command) for tick in range(5000))


@pytest.mark.parametrize("ticks", [0, 1, 255, 256, 257, 5000])
def test_it_goes_on_from_its_memory(ticks: int) -> None:
    """Before, at and after the moments at which the ring grows, and when it has turned."""
    rng, first, second = np.random.default_rng(1), monitor(), monitor()
    steps = [(tick * TICK_NS, rng.normal(size=7), rng.normal(size=7)) for tick in range(ticks + 400)]
    for step in steps[:ticks]:
        first.observe(*step)
    second.restore(from_json(to_json(first.capture()), FollowingErrorSnapshot))
    for step in steps[ticks:]:
        assert first.observe(*step) == second.observe(*step)
    assert to_json(first.capture()) == to_json(second.capture())
    kept = first.capture().times_ns
    assert (np.diff(kept) == TICK_NS).all()
    assert kept[-1] - kept[0] <= 2_001 * TICK_NS, "no more than the long window is kept"

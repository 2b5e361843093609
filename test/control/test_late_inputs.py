"""Late joint states, hold-ups of the process, and gaps in the targets: each is in the status with its cause."""

from __future__ import annotations

from pathlib import Path

import pytest
from timed_loop import MS, TimedLoop

from ik_node.control.late_inputs import GAP, HELD, HELD_UP
from ik_node.control.velocity_controller import DEFERRED
from ik_node.interfaces.clock import NS, Stamped
from ik_node.interfaces.delivery import StreamDelivery, delivered
from ik_node.interfaces.step import OFF_DIRECTION, Mode


@pytest.fixture
def moving(tmp_path: Path) -> TimedLoop:
    """A stream is followed, and nothing is late."""
    loop = TimedLoop(tmp_path / "bag")
    loop.run(1000)
    assert loop.reasons[-1] == "following target_pose"
    assert loop.loop.controller.counts["hold_ups"] == 0
    loop.reasons.clear()
    return loop


def causes(loop: TimedLoop) -> set[str]:
    """Conditions in the statuses, without those of the limits that the accelerations after a stop reach."""
    texts = {text for reason in loop.reasons for text in reason.split("; ")[1:]}
    return {text for text in texts if not text.startswith((OFF_DIRECTION, DEFERRED, "slowed down by joint limits"))}


def test_a_hold_up_of_the_process_is_named(moving: TimedLoop) -> None:
    moving.hold_up(30)
    moving.run(100)
    assert causes(moving) == {f"{HELD}: {HELD_UP}"}
    counts = moving.loop.controller.counts
    assert (counts["hold_ups"], counts["hold_ups_ms"]) == (1, 30)


def test_a_joint_state_that_waited_names_the_machine(moving: TimedLoop) -> None:
    """Clock calls continue, and joint states that were measured in time arrive 11 ms late: DDS did not run."""
    moving.waits = True
    moving.run(11)
    moving.waits = False
    moving.run(100)
    assert causes(moving) == {f"{HELD}: {HELD_UP}"}
    assert moving.loop.controller.counts["hold_ups"] == 0


def test_late_joint_states_are_named(moving: TimedLoop) -> None:
    """The driver is silent, and clock calls continue."""
    moving.silent = True
    moving.run(30)
    moving.silent = False
    moving.run(100)
    assert causes(moving) == {f"{HELD}: joint states came late"}
    assert moving.loop.controller.counts["hold_ups"] == 0


def test_a_gap_in_the_targets_is_named_when_it_has_ended(moving: TimedLoop) -> None:
    """Four targets are lost: the reference decelerates, which the status names with the next target."""
    first = moving.sent
    moving.is_lost = lambda number: first <= number < first + 4
    moving.run(75)
    assert causes(moving) == set()
    moving.run(100)
    assert causes(moving) == {f"{GAP}: targets are late or lost"}
    moving.run(300)
    assert moving.reasons[-1] == "following target_pose"
    counts = moving.loop.controller.counts
    assert (counts["targets"], counts["targets_late"], counts["targets_lost"]) == (moving.sent - 4, 0, 4)


def test_a_gap_in_the_targets_by_a_hold_up_names_the_hold_up(moving: TimedLoop) -> None:
    """Targets that queue up during 90 ms are late, and none is lost."""
    moving.hold_up(90)
    moving.run(100)
    assert f"{GAP}: {HELD_UP}" in causes(moving)
    assert f"{GAP}: targets are late or lost" not in causes(moving)
    counts = moving.loop.controller.counts
    assert counts["targets"] == moving.sent
    assert counts["targets_late"] == 3, "those older than a period"
    assert counts["targets_lost"] == 0


def test_the_end_of_a_stream_is_no_gap(moving: TimedLoop) -> None:
    moving.is_lost = lambda number: True
    moving.run(1500)
    assert moving.loop.mode() is Mode.HOLDING
    assert causes(moving) <= {"holding the last pose"}
    moving.is_lost = lambda number: False
    moving.run(200)
    assert causes(moving) <= {"holding the last pose", "slowed down by joint limits"}
    assert moving.loop.controller.counts["targets_lost"] == 0


@pytest.mark.parametrize("stamped", [True, False])
def test_targets_that_queue_up_are_late_and_not_lost(moving: TimedLoop, stamped: bool) -> None:
    """Without stamps, those that come together after a gap."""
    moving.stamped = stamped
    moving.run(500)
    before = moving.loop.controller.counts
    moving.hold_up(90)
    moving.run(300)
    counts = moving.loop.controller.counts
    assert counts["targets_lost"] - before["targets_lost"] == 0
    assert 3 <= counts["targets_late"] - before["targets_late"] <= 4
    assert counts["targets"] == moving.sent
    assert 0 <= counts["target_age_ms"] <= 20


def test_samples_that_a_sender_publishes_together_are_not_lost() -> None:
    """A sender at 50 Hz that is held up for 0.2 s again and again; their stamps are the times of publication."""
    delivery = StreamDelivery()
    for burst in range(20):
        for index in range(10):
            time_ns = NS + burst * 200 * MS + index * MS // 20
            delivery = delivered(delivery, Stamped(time_ns, time_ns + MS, 0), 0.5)
    assert (delivery.received, delivery.lost, delivery.late) == (200, 0, 0)

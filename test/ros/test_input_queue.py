"""Inputs faster than they can be processed: the queue leaves time for the rest, and keeps the newest messages."""

from __future__ import annotations

import pytest

from ik_node.interfaces.delivery import CLOCK_PERIOD_S
from ik_node.messages.step_codec import CallKind
from ik_node.ros.input_queue import DEPTH, OVERDUE_S, SHARE, InputQueue

OBSTACLES, PATH = CallKind.ON_OBSTACLES, CallKind.ON_TARGET_PATH
STATE, POSE = CallKind.ON_JOINT_STATE, CallKind.ON_TARGET_POSE


class Bench:
    """A queue whose messages take ``cost_s`` of a clock that only they and :meth:`wait` advance."""

    def __init__(self, cost_s: float) -> None:
        self.time_s = 100.0
        self.busy_s = 0.0
        self.cost_s = cost_s
        self.handled: list[tuple[CallKind, bytes]] = []
        self.queue = InputQueue(self.handle, lambda: self.time_s)

    def handle(self, kind: CallKind, data: bytes) -> None:
        self.time_s += self.cost_s
        self.busy_s += self.cost_s
        self.handled.append((kind, data))

    def wait(self, duration_s: float) -> None:
        self.time_s += duration_s


def test_a_message_after_a_pause_is_processed_at_once() -> None:
    bench = Bench(0.005)
    for index in range(5):
        bench.queue.put(OBSTACLES, bytes([index]))
        bench.wait(0.1)
    assert [data[0] for _, data in bench.handled] == [0, 1, 2, 3, 4]
    assert bench.queue.take_skipped() == {}


def test_messages_in_quick_succession_wait_and_keep_their_order() -> None:
    bench = Bench(0.005)
    for index in range(DEPTH):
        bench.queue.put(OBSTACLES, bytes([index]))
    assert len(bench.handled) == 1
    for _ in range(100):
        bench.wait(0.01)
        bench.queue.run()
    assert [data[0] for _, data in bench.handled] == list(range(DEPTH))
    assert bench.queue.take_skipped() == {}


def test_a_flood_takes_a_fifth_of_the_time_and_skips_the_oldest() -> None:
    bench = Bench(0.02)
    start_s = bench.time_s
    for index in range(2000):
        bench.queue.put(OBSTACLES, index.to_bytes(2, "little"))
        bench.wait(0.001)
    elapsed_s = bench.time_s - start_s
    assert bench.busy_s <= 1.05 * elapsed_s / (1.0 + SHARE)
    skipped = bench.queue.take_skipped()
    assert skipped == {OBSTACLES: 2000 - len(bench.handled) - DEPTH}
    for _ in range(200):
        bench.wait(0.01)
        bench.queue.run()
    assert int.from_bytes(bench.handled[-1][1], "little") == 1999


def test_only_the_newest_path_waits() -> None:
    bench = Bench(0.02)
    for index in range(50):
        bench.queue.put(PATH, bytes([index]))
    assert [data[0] for _, data in bench.handled] == [0]
    bench.wait(1.0)
    bench.queue.run()
    bench.queue.run()
    assert [data[0] for _, data in bench.handled] == [0, 49]


def test_an_error_does_not_end_the_queue() -> None:
    bench = Bench(0.0)

    def broken(kind: CallKind, data: bytes) -> None:
        raise ValueError(f"{kind.name} {data!r}")

    queue = InputQueue(broken, lambda: bench.time_s)
    for _ in range(2):
        with pytest.raises(ValueError, match="ON_OBSTACLES"):
            queue.put(OBSTACLES, b"")


class Executor(Bench):
    """Events in the order of their arrival: messages, and the clock timer, which is due again after it was called."""

    TAKE_S = 3e-5
    """Time to take a message over."""

    def run(self, duration_s: float, periods_s: dict[CallKind, float]) -> tuple[float, float]:
        """Returns the longest time between two calls of the timer, and the longest wait of an event, s."""
        start_s = self.time_s
        events = [
            (start_s + index * period_s, kind, index)
            for kind, period_s in periods_s.items()
            for index in range(int(duration_s / period_s))
        ]
        timer_s, called_s, silence_s, wait_s = start_s, start_s, 0.0, 0.0
        for arrival_s, kind, index in sorted(events, key=lambda event: event[0]):
            while timer_s <= arrival_s:
                self.time_s = max(self.time_s, timer_s)
                self.queue.run()
                silence_s, called_s = max(silence_s, self.time_s - called_s), self.time_s
                timer_s = self.time_s + CLOCK_PERIOD_S
            self.time_s = max(self.time_s, arrival_s)
            wait_s = max(wait_s, self.time_s - arrival_s)
            self.time_s += self.TAKE_S
            self.queue.put(kind, index.to_bytes(3, "little"))
        return silence_s, wait_s

    def numbers(self, kind: CallKind) -> list[int]:
        """The processed messages of one input."""
        return [int.from_bytes(data, "little") for found, data in self.handled if found is kind]


def test_streams_of_1_khz_are_processed_at_once_completely_and_in_order() -> None:
    bench = Executor(0.0003)
    silence_s, wait_s = bench.run(5.0, {STATE: 0.001, POSE: 0.001})
    assert wait_s < 0.002
    assert silence_s < 2.0 * CLOCK_PERIOD_S
    assert bench.numbers(STATE) == list(range(5000))
    assert bench.numbers(POSE) == list(range(5000))
    assert bench.queue.take_skipped() == {}


@pytest.mark.parametrize("cost_s", [0.0003, 0.002])
def test_a_flooded_stream_delays_nothing_by_more_than_a_few_periods(cost_s: float) -> None:
    bench = Executor(cost_s)
    silence_s, wait_s = bench.run(5.0, {STATE: 0.004, POSE: 0.0001})
    assert silence_s < 0.05
    assert wait_s < 0.05
    for _ in range(DEPTH):
        bench.queue.run()
    poses = bench.numbers(POSE)
    assert poses == sorted(set(poses))
    assert poses[-1] > 49_000
    assert bench.queue.take_skipped()[POSE] > 20_000
    assert bench.numbers(STATE) == list(range(1250)), "the stream that is no flood loses nothing"


def test_a_hold_up_loses_no_message_of_those_that_dds_has_kept() -> None:
    bench = Executor(0.0003)
    bench.queue.run()
    bench.wait(CLOCK_PERIOD_S + 2.0 * OVERDUE_S)
    assert bench.queue.behind
    for index in range(DEPTH):
        bench.queue.put(STATE, bytes([index]))
        bench.queue.put(POSE, bytes([index]))
    assert bench.handled == []
    bench.queue.run()
    assert [data[0] for _, data in bench.handled] == [index for index in range(DEPTH) for _ in range(2)]
    bench.queue.put(STATE, b"next")
    assert bench.handled[-1] == (STATE, b"next")
    assert bench.queue.take_skipped() == {}

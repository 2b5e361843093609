"""Inputs faster than they can be processed: the queue leaves time for the rest, and keeps the newest messages."""

from __future__ import annotations

import pytest

from ik_node.messages.step_codec import CallKind
from ik_node.ros.input_queue import DEPTH, SHARE, InputQueue

OBSTACLES, PATH = CallKind.ON_OBSTACLES, CallKind.ON_TARGET_PATH


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

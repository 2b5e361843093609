"""Recordings replayed by processes of this computer."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.process import BaseProcess
from threading import Thread

from ik_node.replay.archive.bags import FoundBag
from ik_node.replay.archive.row import BagResult, BagRow, ReplayTask, replay_bag

DIED = "the process that replayed it died; it may need more memory, or a library crashed"


def replay_locally(bags: Sequence[FoundBag], task: ReplayTask, jobs: int) -> Iterator[tuple[FoundBag, BagResult]]:
    """Replays recordings and yields their results as they finish.

    A process that dies takes its pool with it. The recordings that were not finished then are replayed one by one, each
    in a process of its own, so that only the one that kills its process is lost.

    Args:
        bags: The recordings.
        task: What to do with each.
        jobs: Number of processes.
    """
    missing = dict.fromkeys(bags)
    try:
        for bag, result in _in_one_pool(bags, task, jobs):
            del missing[bag]
            yield bag, result
    except BrokenProcessPool:
        for bag in missing:
            try:
                yield from _in_one_pool([bag], task, 1)
            except BrokenProcessPool:
                yield bag, BagResult(BagRow(bag.name, error=DIED), "")


def _in_one_pool(bags: Sequence[FoundBag], task: ReplayTask, jobs: int) -> Iterator[tuple[FoundBag, BagResult]]:
    # Not forked: BLAS and viewers of the parent may have threads.
    workers = max(1, min(jobs, len(bags)))
    pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_end_with_parent)
    try:
        futures = {pool.submit(replay_bag, bag, task): bag for bag in bags}
        for future in as_completed(futures):
            yield futures.pop(future), future.result()  # not kept: it has the report
    finally:
        # Not as a context: its end would revoke the cancellation, and the whole archive would be replayed.
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """Ctrl-C in a terminal reaches the workers, too: they end without a traceback, and the parent ends the rest.

    A worker of a parent that was killed would wait for its next recording for ever.
    """
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # ignored behind `nohup ... &`, as by the parent
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    parent = parent_process()
    if parent is not None:
        Thread(target=_wait_for_end, args=(parent,), daemon=True).start()


def _wait_for_end(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)

"""``ik_benchmark archive``: recordings replayed per minute, by processes and by a Dask cluster of this computer."""

from __future__ import annotations

import argparse
import io
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from ik_node.replay.archive.bags import FoundBag, find_bags
from ik_node.replay.archive.dask_cluster import replay_on_cluster
from ik_node.replay.archive.local_pool import replay_locally
from ik_node.replay.archive.row import SAME, BagResult, ReplayTask
from ik_node.replay.archive.run import replay_archive

BAGS = Path(__file__).parents[1] / "bags"
Distribute = Callable[[Sequence[FoundBag], ReplayTask], Iterator[tuple[FoundBag, BagResult]]]


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(prog="ik_benchmark archive", description=__doc__)
    result.add_argument("--bags", type=Path, default=BAGS, help="folder of recordings [%(default)s]")
    result.add_argument("--copies", type=int, default=3, help="copies of each recording [%(default)s]")
    result.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="[%(default)s]")
    result.add_argument("--reports", action="store_true", help="also write the HTML reports")
    result.add_argument("--json", action="store_true", help="print JSON")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 0 when every recording gives the same bits."""
    options = parser().parse_args(arguments)
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        for number in range(options.copies):
            shutil.copytree(options.bags, Path(scratch) / f"copy_{number}")
        bags, task = find_bags([scratch]), ReplayTask(report=options.reports)
        for workers in options.workers:
            found.append(measure(f"{workers} processes", bags, task, partial(replay_locally, jobs=workers)))
            found += on_cluster(workers, bags, task)
    if options.json:
        print(json.dumps(found, indent=1))
    else:
        print(f"{len(bags)} recordings, {'with' if options.reports else 'without'} reports")
        for entry in found:
            print(f"{entry['where']:<16}{entry['per_minute']:6.0f} a minute, {entry['same']} with the same bits")
    return 0 if all(entry["same"] == len(bags) for entry in found) else 1


def measure(where: str, bags: Sequence[FoundBag], task: ReplayTask, distribute: Distribute) -> dict[str, object]:
    """Replay all recordings once; the start of the processes counts."""
    with tempfile.TemporaryDirectory() as folder:
        begin_s = time.perf_counter()
        rows = replay_archive(bags, task, distribute, Path(folder), io.StringIO()).rows
        took_s = time.perf_counter() - begin_s
    same = sum(row.replay == SAME for row in rows)
    return {"where": where, "took_s": took_s, "per_minute": 60.0 * len(bags) / took_s, "same": same}


def on_cluster(workers: int, bags: Sequence[FoundBag], task: ReplayTask) -> list[dict[str, object]]:
    """The same on a cluster, which is started before the measurement; nothing without the package distributed."""
    try:
        from distributed import LocalCluster
    except ImportError:
        return []
    with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        return [measure(f"{workers} Dask workers", bags, task, partial(replay_on_cluster, address=address))]

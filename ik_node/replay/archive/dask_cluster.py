"""Recordings replayed by the workers of an existing Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ik_node.errors import MissingPackageError, RecordingError
from ik_node.recording.environment import source_digest
from ik_node.replay.archive.bags import FoundBag
from ik_node.replay.archive.row import BagResult, BagRow, ReplayTask, replay_bag

RETRIES = 3
"""Attempts after an error of a task. Bags of a worker that ends are replayed by the others anyway."""
CONNECT_TIMEOUT_S = 30


def replay_on_cluster(bags: Sequence[FoundBag], task: ReplayTask, address: str) -> Iterator[tuple[FoundBag, BagResult]]:
    """Replays recordings and yields their results as they finish.

    The names of the recordings have to be readable for the workers: paths on a shared disk, or fsspec URLs.

    Args:
        bags: The recordings.
        task: What to do with each.
        address: Of the scheduler, such as ``tcp://10.0.0.5:8786``.

    Raises:
        MissingPackageError: ``dask`` or ``distributed`` is not installed.
        RecordingError: There is no scheduler at the address, no worker, or a worker has another version of ik_node.
    """
    with _connected(address) as client:
        _check_workers(client, address)
        futures = {client.submit(replay_bag, bag, task, pure=False, retries=RETRIES): bag for bag in bags}
        for future in _as_completed(list(futures)):
            bag = futures.pop(future)
            error = future.exception()
            if error is None:
                result: BagResult = future.result()
            else:
                result = BagResult(BagRow(bag.name, error=f"{type(error).__name__}: {error}"), "")
            future.release()  # the report is large
            yield bag, result


def _connected(address: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingPackageError(error) from error
    try:
        return Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise RecordingError(f"no Dask scheduler answers at '{address}': {error}") from error


def _as_completed(futures: list[Any]) -> Any:
    from distributed import as_completed

    return as_completed(futures)


def _check_workers(client: Any, address: str) -> None:
    digests: dict[str, str] = client.run(source_digest, on_error="return")
    if not digests:
        raise RecordingError(f"the Dask cluster at '{address}' has no worker")
    here = source_digest()
    others = [worker for worker, digest in digests.items() if digest != here]
    if others:
        reason = digests[others[0]]
        found = reason if isinstance(reason, str) else f"none: {reason}"
        raise RecordingError(f"worker {others[0]} has another ik_node; expected {here}, found {found}")

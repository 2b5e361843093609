"""The archive on a Dask cluster, behind fsspec URLs, and as Parquet: with the packages of the extra ``archive``."""

from __future__ import annotations

import io
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support import PROJECT

from ik_node.errors import RecordingError
from ik_node.replay.archive import table
from ik_node.replay.archive.bags import find_bags
from ik_node.replay.archive.dask_cluster import replay_on_cluster
from ik_node.replay.archive.row import BROKEN, SAME, BagRow, ReplayTask, replay_bag

QUICK = ReplayTask(report=False)
REASON = "needs the packages of the extra 'archive'"


@pytest.fixture
def cluster() -> Iterator[Any]:
    """Two workers, each a process with one thread."""
    distributed = pytest.importorskip("distributed", reason=REASON)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as made:
        yield made


def test_a_killed_worker_costs_no_row(cluster: Any, tmp_path: Path) -> None:
    """One of two workers is killed after the first result; its recordings are replayed by the other."""
    for number in range(4):
        shutil.copytree(PROJECT / "bags" / "plain", tmp_path / f"run {number}")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "broken_0.mcap").write_bytes(b"no MCAP")
    bags = find_bags([str(tmp_path)])
    found: dict[str, str] = {}
    for bag, result in replay_on_cluster(bags, QUICK, cluster.scheduler_address):
        if not found:
            victim = next(iter(cluster.workers.values()))
            os.kill(victim.pid, signal.SIGKILL)
        found[bag.name] = result.row.replay
    assert sorted(found) == [bag.name for bag in bags]
    assert [found[bag.name] for bag in bags] == [BROKEN, SAME, SAME, SAME, SAME]


def test_an_address_without_a_scheduler_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason=REASON)
    monkeypatch.setattr("ik_node.replay.archive.dask_cluster.CONNECT_TIMEOUT_S", 1)
    with pytest.raises(RecordingError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'"):
        list(replay_on_cluster([], QUICK, "tcp://127.0.0.1:9"))


@pytest.mark.parametrize("protocol", ["memory", "file"])
def test_recordings_behind_urls_are_copied_and_replayed(protocol: str, tmp_path: Path) -> None:
    """With the trajectory beside the folder of the recording."""
    fsspec = pytest.importorskip("fsspec", reason=REASON)
    place = "/fleet" if protocol == "memory" else str(tmp_path / "fleet")
    files = fsspec.filesystem(protocol)
    folder = f"{place}/monday/bag"
    files.makedirs(folder, exist_ok=True)
    for path in (PROJECT / "bags" / "plain").iterdir():
        files.pipe_file(f"{folder}/{path.name}", path.read_bytes())
    bags = find_bags([f"{protocol}://{place}"])
    assert [bag.name.rpartition("/")[2] for bag in bags] == ["bag"]
    assert find_bags([f"{protocol}://{place}"]) == bags
    row = replay_bag(bags[0], QUICK).row
    assert row.error == ""
    assert (row.replay, row.robot) == (SAME, "panda")
    files.pipe_file(f"{place}/monday/trajectory.csv", b"broken")
    assert "trajectory" in replay_bag(bags[0], QUICK).row.error
    with pytest.raises(RecordingError, match="nowhere"):
        find_bags(["nowhere://fleet"])


def test_parquet_has_the_types_of_the_columns(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason=REASON)
    from pyarrow import parquet

    rows = [
        BagRow("a", position_rms_mm=0.5, steps=7, what_if={"plain": {"position_rms_mm": 0.25}}),
        BagRow("b", error="broken"),
    ]
    table.write_parquet(rows, tmp_path / "table.parquet")
    read = parquet.read_table(tmp_path / "table.parquet")
    assert read.column_names == list(table.columns_of(rows))
    assert read.to_pylist()[0]["position_rms_mm"] == 0.5
    assert read.to_pylist()[0]["position_rms_mm [plain]"] == 0.25
    assert read.to_pylist()[1]["position_rms_mm"] is None
    assert read.to_pylist()[1]["error"] == "broken"
    assert io.BytesIO((tmp_path / "table.parquet").read_bytes()).read(4) == b"PAR1"

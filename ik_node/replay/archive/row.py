"""One row of the table: a recording, replayed and described."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ik_node.errors import IkNodeError
from ik_node.recording.environment import SOURCE
from ik_node.replay.archive.bags import FoundBag, local_copy
from ik_node.replay.bitwise import Comparison, replay
from ik_node.replay.call_source import RecordingSource
from ik_node.replay.what_if import RECORDED, VariantMetrics, compare, ground_truth_of, make_variants
from ik_node.report.html import as_html
from ik_node.report.reported_run import ReportedRun, read_reported_runs
from ik_node.report.verdict import verdict
from ik_node.settings.schema import Value

SAME, EQUAL, DIFFERENT, BROKEN = "same bits", "equal within rounding", "different", "not replayable"
WHAT_IF = ("position_rms_mm", "position_max_mm", "orientation_rms_mrad", "energy_mean_j", "clearance_min_mm")
"""Metrics of a what-if run in a row."""

_one_at_a_time = threading.Lock()  # a worker may have threads; matplotlib and Pinocchio's data are not thread-safe


class ReplayTask(NamedTuple):
    """What to do with every recording."""

    methods: tuple[str, ...] = ()
    """Of the what-if runs; ``all`` for every one."""
    changes: Mapping[str, Value] = {}
    """Parameter -> value of the what-if runs."""
    report: bool = True
    """Whether an HTML report is written."""


class BagRow(NamedTuple):
    """A row of the table. What is not known is empty or None."""

    bag: str
    robot: str = ""
    method: str = ""
    version: str = ""
    """Of ik_node that recorded it."""
    recorded_utc: str = ""
    verdict: str = ""
    cause: str = ""
    replay: str = BROKEN
    """One of ``SAME``, ``EQUAL``, ``DIFFERENT``, ``BROKEN``."""
    first_difference: str = ""
    position_rms_mm: float | None = None
    position_max_mm: float | None = None
    orientation_rms_mrad: float | None = None
    duration_s: float | None = None
    slowed_s: float | None = None
    worst_limit: str = ""
    """The limit that slowed the arm longest."""
    steps: int | None = None
    error: str = ""
    """Why the recording could not be replayed or described."""
    what_if: Mapping[str, Mapping[str, float | None]] = {}
    """Simulated run -> metric -> value; ``recorded`` are the recorded settings, simulated like the others."""


class BagResult(NamedTuple):
    """A row and its report."""

    row: BagRow
    html: str
    """Empty for none."""


def replay_bag(bag: FoundBag, task: ReplayTask) -> BagResult:
    """Replays and describes one recording; never raises for a recording that cannot be read."""
    if bag.error:
        return BagResult(BagRow(bag.name, error=bag.error), "")
    with _one_at_a_time:
        row, html = BagRow(bag.name), ""
        try:
            with local_copy(bag.name) as path:
                (reported,) = read_reported_runs([path])
                row = _described(row, reported)
                if task.report:
                    html = as_html([reported._replace(name=bag.name.rstrip("/").rpartition("/")[2])])
                row = _replayed(row, path)
                if task.methods or task.changes:
                    row = row._replace(what_if=_what_if(path, task))
        except Exception as error:  # one broken recording is a row, whatever is broken in it
            text = str(error) if isinstance(error, IkNodeError) else f"{type(error).__name__}: {error}"
            row = row._replace(error=_without_name(" ".join(text.split()), bag.name))
        return BagResult(row, html)


def _without_name(text: str, name: str) -> str:
    """An error without the name of the recording, which is in the row already."""
    folder = name.rstrip("/")
    return text.removeprefix(f"'{folder}'").lstrip(": ").replace(f"'{folder}/", "'")


def _described(row: BagRow, reported: ReportedRun) -> BagRow:
    metrics, found = reported.metrics, verdict(reported.metrics)
    errors = None if metrics.tracking is None else metrics.tracking.settled
    slowed_by = metrics.scaling.slowed_by
    return row._replace(
        robot=metrics.robot,
        method=metrics.method,
        version=f"{reported.run.versions.get('ik_node', '')} {reported.run.versions.get(SOURCE, '')}".strip(),
        recorded_utc=metrics.recorded_utc,
        verdict=found.text,
        cause=found.cause.value,
        position_rms_mm=None if errors is None else _known(errors.position_rms_mm),
        position_max_mm=None if errors is None else _known(errors.position_max_mm),
        orientation_rms_mrad=None if errors is None else _known(errors.orientation_rms_mrad),
        duration_s=_known(metrics.duration_s),
        slowed_s=_known(metrics.scaling.slowed_s),
        worst_limit=slowed_by[0][0] if slowed_by else "",
        steps=metrics.ticks.number,
    )


def _replayed(row: BagRow, path: Path) -> BagRow:
    result = replay(RecordingSource(path))
    return row._replace(replay=_outcome(result), first_difference=_first(result))


def _outcome(result: Comparison) -> str:
    if result.identical:
        return SAME
    return EQUAL if result.passed else DIFFERENT


def _first(result: Comparison) -> str:
    first = result.first
    return "" if first is None else f"{first.field} by {first.size:.3g} at {first.time_s:.3f} s"


def _what_if(path: Path, task: ReplayTask) -> dict[str, dict[str, float | None]]:
    source = partial(RecordingSource, path)
    variants = (RECORDED, *make_variants(source().initial_settings, task.methods, task.changes))
    found = compare(source, variants, ground_truth_of(path, ""), jobs=1)
    return {run.name: _metrics(run) for run in found}


def _metrics(run: VariantMetrics) -> dict[str, float | None]:
    return {name: _known(getattr(run, name)) for name in WHAT_IF}


def _known(value: float) -> float | None:
    """None for NaN and infinity, which JSON does not have."""
    return float(value) if abs(value) < float("inf") else None

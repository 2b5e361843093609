"""Simulated runs of the same targets with other settings, recorded each and reported side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from ik_node.replay.rerecord import record_simulation
from ik_node.replay.what_if import SourceFactory, Variant
from ik_node.report.atomic_write import write_report
from ik_node.report.quantities import UNWEIGHTED
from ik_node.report.reported_run import read_reported_runs
from ik_node.report.table import METHOD_LABELS, as_table
from ik_node.robot.simulated_arm import ArmModel


def record_variants(
    opened: SourceFactory,
    variants: Sequence[Variant],
    out: Path,
    timer_ns: Callable[[], int],
    model: ArmModel | None = None,
) -> list[Path]:
    """Records every run on its own, for ``ik_report`` and ``ik_view``.

    Args:
        opened: Opens the source; called once per variant.
        variants: Settings to simulate; the name of each becomes that of its folder.
        out: Folder of the recordings.
        timer_ns: Clock that measures the computing time of a Step, ns.
        model: Lag and delay of the simulated arm; default: ideal.

    Returns:
        The recordings, in the order of the variants.

    Raises:
        RecordingError: A folder exists or cannot be written.
    """
    bags = []
    for variant in variants:
        name = "".join(character if character.isalnum() or character in "._-" else "_" for character in variant.name)
        record_simulation(opened(), variant.changes, out / name, model, timer_ns)
        bags.append(out / name)
    return bags


def report_side_by_side(bags: Sequence[Path], truth: Path | None, to: Path) -> str:
    """Writes a report on several recordings, and compares energies, multipliers and null-space motion.

    Args:
        bags: The recordings.
        truth: Ground truth of all; default: as of each.
        to: PNG, PDF, HTML or SVG file.

    Returns:
        The comparison as a table.

    Raises:
        IkNodeError: A recording cannot be read, or the file cannot be written.
    """
    reported_runs = read_reported_runs(bags, truth)
    write_report(reported_runs, to)
    table = as_table(reported_runs, labels=METHOD_LABELS)
    without = [reported.metrics.method for reported in reported_runs if reported.metrics.method in UNWEIGHTED]
    if without:
        table += f"\nλ task of {', '.join(dict.fromkeys(without))} has no unit; with the mass matrix it is momentum"
    return table

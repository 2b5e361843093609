"""Repeat a recorded run with the same inputs, and compare the commands bit for bit.

Several recordings, or folders of them: replay all side by side, and write one table (text, CSV, JSON, Parquet, and a
page that opens the report of each). What was done in an earlier call is not done again.

With --method or --set: run the recorded targets with other settings on a simulated arm (closed loop). Bags that were
not recorded by ik_node are read too, with --robot or --config.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError, InputError, RecordingError, SettingsError

if TYPE_CHECKING:
    from ik_node.replay.what_if import SourceFactory, Variant
    from ik_node.report.ground_truth import GroundTruth

DIFFERENT_BITS, UNUSABLE = 1, 2
TABLE = "ik_replay_table"
"""Folder of the table of many recordings."""

EPILOG = """\
examples:
  ik_replay my_run/bag                            bit for bit
  ik_replay my_run/bag --method inertia_weighted  the recorded targets with another method, simulated
  ik_replay my_run/bag --method all --report methods.png   energies, multipliers, null-space motion of all methods
  ik_replay my_run/bag --method all --set gain=[5.0,5.0] --open-loop
  ik_replay other_bag --robot panda               a bag of another program
  ik_replay my_run/bag --ros --input target_pose  the recorded targets to a running node
  ik_replay my_runs/ --jobs 2                     all recordings below a folder: one table

exit code: 0 same bits (other machine: same but for rounding), 1 different, 2 not replayable;
of many recordings the highest
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_replay", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    about = "recording: a folder, or one of its files; several, or a folder of recordings, or fsspec URLs: a table"
    result.add_argument("bag", nargs="+", help=about)
    result.add_argument("--node", default="", help="full name of the node [the only one recorded]")
    result.add_argument("--json", action="store_true", help="print JSON")
    what_if = result.add_argument_group("what if")
    about = "method to run instead of the recorded one, or `all`; may be repeated"
    what_if.add_argument("--method", action="append", default=[], help=about)
    about = "value of a parameter in every run but the recorded one; may be repeated"
    what_if.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=about)
    about = "also compare the commands on the recorded joint states, without a simulated arm"
    what_if.add_argument("--open-loop", action="store_true", help=about)
    about = f"new folder for recordings of the simulated runs; many recordings: folder of the table [{TABLE}]"
    what_if.add_argument("--out", type=Path, help=about)
    about = "also report on the simulated runs side by side, as a PNG, PDF, HTML or SVG file"
    what_if.add_argument("--report", type=Path, metavar="FILE", help=about)
    what_if.add_argument("--jobs", type=int, help=f"number of simultaneous runs or recordings [{os.cpu_count()}]")
    many = result.add_argument_group("many recordings")
    about = (
        "replay on this Dask cluster, e.g. tcp://10.0.0.5:8786, whose workers can read the recordings by their names"
    )
    many.add_argument("--dask", metavar="ADDRESS", help=about)
    many.add_argument("--no-reports", action="store_true", help="only the table, which is faster")
    external = result.add_argument_group("external bags: rosbag2 (sqlite3, MCAP), rosbag1")
    external.add_argument("--robot", default="", help="name in example-robot-data [robot_description in the bag]")
    external.add_argument("--config", type=Path, help="parameter file [config/<robot>.yaml where there is one]")
    about = "use a topic of the bag as an input: joint_states, target_pose, ..."
    external.add_argument("--remap", action="append", default=[], metavar="TOPIC:=INPUT", help=about)
    about = "joint positions at the start, for a bag without joint states"
    external.add_argument("--start", nargs="+", type=float, default=[], metavar="Q", help=about)
    ros = result.add_argument_group("replay to a running node")
    ros.add_argument("--ros", action="store_true", help="publish the recorded inputs at their recorded times instead")
    ros.add_argument("--to", help="full name of that node [/ik_node]")
    ros.add_argument("--input", action="append", default=[], help="publish this input only; may be repeated")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Replay and print the comparison; the exit code is that of --help."""
    options = parser().parse_args(arguments)
    external = bool(options.robot or options.config or options.remap or options.start)
    from ik_node.replay.archive.bags import is_archive

    try:
        if is_archive(options.bag):
            return _archive(options)
        options.bag = Path(options.bag[0])
        _refuse_without_effect(options, external)
        opened = _external_bag(options) if external else _own_bag(options)
        if options.ros:
            return _publish(opened, options)
        if external or options.method or options.set:
            return _what_if(opened, options, external)
        return _bitwise(options)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE


def _refuse_without_effect(options: argparse.Namespace, external: bool) -> None:
    """Raise SettingsError for options that this call would ignore, and for a number of runs that is none."""
    if options.jobs is not None and options.jobs < 1:
        raise SettingsError(f"--jobs is {options.jobs}; valid: 1 or more")
    simulates = not options.ros and bool(external or options.method or options.set)
    for names, has_effect, reason in (
        (("to", "input"), options.ros, "without --ros"),
        (("method", "set"), not options.ros, "with --ros"),
        (("open_loop",), simulates and not external, "without --method or --set, and for a bag of another program"),
        (("out", "report", "jobs"), simulates, "without --method, --set or a bag of another program"),
        (("node",), not external, "for a bag of another program"),
        (("dask", "no_reports"), False, "for one recording"),
    ):
        given = ["--" + name.replace("_", "-") for name in names if getattr(options, name)]
        if given and not has_effect:
            raise SettingsError(f"{', '.join(given)}: no effect {reason}")


def _archive(options: argparse.Namespace) -> int:
    """Replay many recordings and print their table."""
    from ik_node.replay.archive import table
    from ik_node.replay.archive.bags import find_bags
    from ik_node.replay.archive.dask_cluster import replay_on_cluster
    from ik_node.replay.archive.local_pool import replay_locally
    from ik_node.replay.archive.row import BROKEN, DIFFERENT, ReplayTask
    from ik_node.replay.archive.run import replay_archive
    from ik_node.settings.parameter_file import parse_assignment

    single = ("node", "open_loop", "report", "robot", "config", "remap", "start", "ros", "to", "input")
    given = ["--" + name.replace("_", "-") for name in single if getattr(options, name)]
    if given:
        raise SettingsError(f"{', '.join(given)}: no effect for many recordings")
    bags = find_bags(options.bag)
    task = ReplayTask(tuple(options.method), dict(map(parse_assignment, options.set)), not options.no_reports)
    if options.dask:
        distribute = partial(replay_on_cluster, address=options.dask)
    else:
        distribute = partial(replay_locally, jobs=max(1, options.jobs or os.cpu_count() or 1))
    found = replay_archive(bags, task, distribute, options.out or Path(TABLE), clock_s=time.monotonic)
    print(table.as_json(found.rows) if options.json else table.as_text(found.rows))
    for text in (*found.files, *found.notes):
        print(text, file=sys.stderr)
    outcomes = {row.replay for row in found.rows}
    return UNUSABLE if BROKEN in outcomes else DIFFERENT_BITS if DIFFERENT in outcomes else 0


def _bitwise(options: argparse.Namespace) -> int:
    from ik_node.replay import text
    from ik_node.replay.bitwise import replay
    from ik_node.replay.call_source import RecordingSource

    recorded = RecordingSource(options.bag, options.node)
    begin = time.perf_counter()
    found = replay(recorded)
    took_s = time.perf_counter() - begin
    if options.json:
        print(json.dumps({**text.as_plain(found), "took_s": took_s}, indent=1))
    else:
        print(text.as_text(recorded, found, took_s))
    return 0 if found.passed else DIFFERENT_BITS


def _what_if(opened: SourceFactory, options: argparse.Namespace, external: bool) -> int:
    from ik_node.replay import text
    from ik_node.replay.call_source import RecordingSource
    from ik_node.replay.external_bag import ExternalBag
    from ik_node.replay.what_if import (
        RECORDED,
        Variant,
        compare,
        compare_open_loop,
        ground_truth_of,
        make_variants,
    )
    from ik_node.report.atomic_write import check_suffix
    from ik_node.report.ground_truth import ground_truth_from_targets
    from ik_node.settings.parameter_file import parse_assignment

    if options.report is not None:
        check_suffix(options.report)
    source = opened()
    first = Variant("as configured", {}) if external else RECORDED
    wanted = (first, *make_variants(source.initial_settings, options.method, dict(map(parse_assignment, options.set))))
    if isinstance(source, ExternalBag):
        truth = ground_truth_from_targets(source.targets(), source.base_frame)
    else:
        truth = ground_truth_of(options.bag, options.node)
    begin = time.perf_counter()
    found = compare(opened, wanted, truth, options.jobs or os.cpu_count() or 1)
    took_s = time.perf_counter() - begin
    commands = []
    if options.open_loop and not external:
        commands = compare_open_loop(partial(RecordingSource, options.bag, options.node), wanted[1:])
    if options.json:
        document = {
            "closed_loop": [dataclasses.asdict(run) for run in found],
            "open_loop": [run._asdict() for run in commands],
            "against": truth.source if truth is not None else None,
            "used": source.used if isinstance(source, ExternalBag) else None,
            "took_s": took_s,
        }
        print(json.dumps(document, indent=1))
    else:
        if isinstance(source, ExternalBag):
            print(text.used_topics(source.used))
        print(text.closed_loop_table(found, _against(truth)))
        if commands:
            print("\n" + text.open_loop_table(commands))
    if options.out is not None or options.report is not None:
        _record(opened, wanted, options, external)
    return 0


def _record(opened: SourceFactory, wanted: Sequence[Variant], options: argparse.Namespace, external: bool) -> None:
    """Record every run on its own, and report on them side by side, as wanted."""
    from ik_node.replay.side_by_side import record_variants, report_side_by_side
    from ik_node.report.reported_run import truth_beside

    with TemporaryDirectory() as scratch:
        bags = record_variants(opened, wanted, options.out or Path(scratch), time.perf_counter_ns)
        if options.out is not None:
            for bag in bags:
                print(f"recording {bag}", file=sys.stderr)
        if options.report is not None:
            table = report_side_by_side(bags, None if external else truth_beside(options.bag), options.report)
            if not options.json:
                print("\n" + table)
            print(options.report, file=sys.stderr)


def _own_bag(options: argparse.Namespace) -> SourceFactory:
    """Return the recorded calls; raises RecordingError listing the topics of the bag if ik_node did not record it."""
    from ik_node.replay.call_source import RecordingSource
    from ik_node.replay.external_bag import is_external_bag

    opened = partial(RecordingSource, options.bag, options.node)
    try:
        opened()
    except RecordingError:
        if is_external_bag(options.bag):
            _external_bag(options)()
        raise
    return opened


def _against(truth: GroundTruth | None) -> str:
    return "nothing: there were no targets" if truth is None else f"the {truth.source}"


def _external_bag(options: argparse.Namespace) -> SourceFactory:
    """Return the bag with the settings of the command line."""
    from ik_node import resources
    from ik_node.replay.external_bag import ExternalBag
    from ik_node.settings.groups import Settings
    from ik_node.settings.parameter_file import read_settings

    settings = Settings()
    if options.config is not None:
        settings = read_settings(options.config)
    elif options.robot:
        try:
            settings = read_settings(resources.config_file(f"{options.robot}.yaml"))
        except SettingsError:  # no configuration for this robot: defaults
            settings = Settings()
    if options.robot:
        settings = settings.with_values({"robot": options.robot})
    remap = dict(map(_remapping, options.remap))
    return partial(ExternalBag, options.bag, settings, remap, tuple(options.start))


def _remapping(argument: str) -> tuple[str, str]:
    topic, sign, name = argument.partition(":=")
    if not (topic and sign and name):
        raise InputError(f"'{argument}' is not a remapping; expected TOPIC:=INPUT")
    return topic, name


def _publish(opened: SourceFactory, options: argparse.Namespace) -> int:
    # The other tasks need no ROS.
    from ik_node.ros.bag_player import play

    counts = play(opened(), options.to or "/ik_node", options.input)
    print(json.dumps(counts) if options.json else "published " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())

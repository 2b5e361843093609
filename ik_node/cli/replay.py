"""``ik_replay BAG``: a recording through the controller again, and whether the same commands come of it.

With ``--method`` or ``--set``: what would have been with other settings, the loop closed in the simulator. Bags that
others recorded are input too, with ``--robot`` or ``--config``.
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

from ik_node import resources
from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError, InputError, RecordingError, SettingsError
from ik_node.recording.call_log import RecordedCalls
from ik_node.replay import text
from ik_node.replay.bitwise import replay
from ik_node.replay.external_bag import ForeignBag, bag_of_others
from ik_node.replay.rerecord import record_simulation
from ik_node.replay.what_if import (
    RECORDED,
    Opened,
    Variant,
    compare,
    compare_open_loop,
    parsed,
    truth_of,
    variants,
)
from ik_node.report.ground_truth import Truth, truth_from_targets
from ik_node.settings.groups import Settings
from ik_node.settings.parameter_file import read_settings

PARTS, UNUSABLE = 1, 2


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="ik_replay",
        description=__doc__,
        epilog="Exit code 0: the same bits (elsewhere: the same but for rounding); 1: it parts; 2: it cannot be tried.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("bag", type=Path, help="recording: a folder, or one of its files")
    result.add_argument("--node", default="", help="full name of the node [the only one recorded]")
    result.add_argument("--json", action="store_true", help="figures for machines")
    what_if = result.add_argument_group("what if")
    about = "another method instead of the recorded one, or `all`; more than once for several"
    what_if.add_argument("--method", action="append", default=[], help=about)
    about = "another value of a parameter, in every run but the recorded one"
    what_if.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help=about)
    about = "compare commands on the recorded joint states too: nothing moves"
    what_if.add_argument("--open-loop", action="store_true", help=about)
    what_if.add_argument("--out", type=Path, help="new folder for recordings of the simulated runs")
    what_if.add_argument("--jobs", type=int, default=os.cpu_count(), help="runs at once [%(default)s]")
    foreign = result.add_argument_group("bags of others: rosbag2 (sqlite3, MCAP), rosbag1")
    foreign.add_argument("--robot", default="", help="name in example-robot-data [robot_description in the bag]")
    foreign.add_argument("--config", type=Path, help="parameter file [config/<robot>.yaml where there is one]")
    about = "take a topic of the bag for an input: joint_states, target_pose, ..."
    foreign.add_argument("--remap", action="append", default=[], metavar="TOPIC:=INPUT", help=about)
    about = "joint positions at the start, for a bag without joint states"
    foreign.add_argument("--start", nargs="+", type=float, default=[], metavar="Q", help=about)
    ros = result.add_argument_group("to a running node")
    ros.add_argument("--ros", action="store_true", help="publish the recorded inputs at their recorded pace instead")
    ros.add_argument("--to", default="/ik_node", help="full name of that node [%(default)s]")
    ros.add_argument("--input", action="append", default=[], help="publish this input only; more than once for several")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Replays and says what came of it."""
    options = parser().parse_args(arguments)
    foreign = bool(options.robot or options.config or options.remap or options.start)
    try:
        opened = _foreign(options) if foreign else _ours(options)
        if options.ros:
            return _feed(opened, options)
        if foreign or options.method or options.set:
            return _what_if(opened, options, foreign)
        return _same(options)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE


def _same(options: argparse.Namespace) -> int:
    recorded = RecordedCalls(options.bag, options.node)
    begin = time.perf_counter()
    found = replay(recorded)
    took_s = time.perf_counter() - begin
    if options.json:
        print(json.dumps({**text.as_plain(found), "took_s": took_s}, indent=1))
    else:
        print(text.as_text(recorded, found, took_s))
    return 0 if found.holds else PARTS


def _what_if(opened: Opened, options: argparse.Namespace, foreign: bool) -> int:
    source = opened()
    first = Variant("as configured", {}) if foreign else RECORDED
    wanted = (first, *variants(source.begins_with, options.method, dict(map(parsed, options.set))))
    if isinstance(source, ForeignBag):
        truth = truth_from_targets(source.targets(), source.base_frame)
    else:
        truth = truth_of(options.bag, options.node)
    begin = time.perf_counter()
    found = compare(opened, wanted, truth, max(1, options.jobs or 1))
    took_s = time.perf_counter() - begin
    commands = []
    if options.open_loop and not foreign:
        commands = compare_open_loop(partial(RecordedCalls, options.bag, options.node), wanted[1:])
    if options.json:
        document = {
            "closed_loop": [dataclasses.asdict(run) for run in found],
            "open_loop": [run._asdict() for run in commands],
            "against": truth.source if truth is not None else None,
            "used": source.used if isinstance(source, ForeignBag) else None,
            "took_s": took_s,
        }
        print(json.dumps(document, indent=1))
    else:
        if isinstance(source, ForeignBag):
            print(text.used_topics(source.used))
        print(text.closed_loop_table(found, _against(truth)))
        if commands:
            print("\n" + text.open_loop_table(commands))
    if options.out is not None:
        _record(opened, wanted, options.out)
    return 0


def _ours(options: argparse.Namespace) -> Opened:
    """A recording of ours; RecordingError with what the bag holds when it is somebody else's."""
    opened = partial(RecordedCalls, options.bag, options.node)
    try:
        opened()
    except RecordingError:
        if bag_of_others(options.bag):
            _foreign(options)()
        raise
    return opened


def _against(truth: Truth | None) -> str:
    return "nothing: there were no targets" if truth is None else f"the {truth.source}"


def _record(opened: Opened, wanted: Sequence[Variant], out: Path) -> None:
    """Every run as a recording of its own, for ``ik_report`` and ``ik_view``."""
    for variant in wanted:
        name = "".join(character if character.isalnum() or character in "._-" else "_" for character in variant.name)
        record_simulation(opened(), variant.changes, out / name)
        print(f"recording {out / name}", file=sys.stderr)


def _foreign(options: argparse.Namespace) -> Opened:
    """The bag with the settings that the command line asks for."""
    settings = Settings()
    if options.config is not None:
        settings = read_settings(options.config)
    elif options.robot:
        try:
            settings = read_settings(resources.config_file(f"{options.robot}.yaml"))
        except SettingsError:  # a robot without a configuration of ours: defaults
            settings = Settings()
    if options.robot:
        settings = settings.with_values({"robot": options.robot})
    remap = dict(map(_remapping, options.remap))
    return partial(ForeignBag, options.bag, settings, remap, tuple(options.start))


def _remapping(text_of_it: str) -> tuple[str, str]:
    topic, sign, name = text_of_it.partition(":=")
    if not (topic and sign and name):
        raise InputError(f"'{text_of_it}' is no remapping; expected TOPIC:=INPUT")
    return topic, name


def _feed(opened: Opened, options: argparse.Namespace) -> int:
    # Imported only now: the rest works without ROS.
    from ik_node.ros.bag_player import feed

    counts = feed(opened(), options.to, options.input)
    print(json.dumps(counts) if options.json else "published " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())

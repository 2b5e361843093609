"""``ik_replay BAG``: a recording through the controller again, and whether the same commands come of it.

With ``--method`` or ``--set``: what would have been with other settings, the loop closed in the simulator.
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

from ik_node.errors import IkNodeError
from ik_node.recording.events import RecordedCalls
from ik_node.replay import text
from ik_node.replay.recorded import record_simulation
from ik_node.replay.same import replay
from ik_node.replay.what_if import Opened, Variant, compare, compare_open_loop, parsed, truth_of, variants
from ik_node.report.truth import Truth

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
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Replays and says what came of it."""
    options = parser().parse_args(arguments)
    try:
        return _what_if(options) if options.method or options.set else _same(options)
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


def _what_if(options: argparse.Namespace) -> int:
    opened = partial(RecordedCalls, options.bag, options.node)
    wanted = variants(opened().begins_with, options.method, dict(map(parsed, options.set)))
    truth = truth_of(options.bag, options.node)
    begin = time.perf_counter()
    found = compare(opened, wanted, truth, max(1, options.jobs or 1))
    took_s = time.perf_counter() - begin
    commands = compare_open_loop(opened, wanted) if options.open_loop else []
    if options.json:
        document = {
            "closed_loop": [dataclasses.asdict(run) for run in found],
            "open_loop": [run._asdict() for run in commands],
            "against": truth.source if truth is not None else None,
            "took_s": took_s,
        }
        print(json.dumps(document, indent=1))
    else:
        print(text.closed_loop_table(found, _against(truth)))
        if commands:
            print("\n" + text.open_loop_table(commands))
    if options.out is not None:
        _record(opened, wanted, options.out)
    return 0


def _against(truth: Truth | None) -> str:
    return "nothing: there were no targets" if truth is None else f"the {truth.source}"


def _record(opened: Opened, wanted: Sequence[Variant], out: Path) -> None:
    """Every run as a recording of its own, for ``ik_report`` and ``ik_view``."""
    for variant in (Variant("recorded", {}), *wanted):
        name = "".join(character if character.isalnum() or character in "._-" else "_" for character in variant.name)
        record_simulation(opened(), variant.changes, out / name)
        print(f"recording {out / name}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())

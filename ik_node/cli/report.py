"""Report on a recording, or compare several: figures of merit as text or JSON, and pictures."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ik_node.cli.entry import command_line
from ik_node.cli.pose_file_options import add_options, format_from, refuse_given
from ik_node.errors import IkNodeError

if TYPE_CHECKING:
    from ik_node.report.reported_run import ReportedRun

UNUSABLE = 2
MOST_IN_NAME = 3
"""Largest number of recordings in the name of a file."""

EPILOG = """\
examples:
  ik_report my_run/bag
  ik_report my_run/bag --html --png
  ik_report first/bag second/bag --out compared.pdf
  ik_report my_run/bag --truth poses.txt --json

exit code: 0 reported, 2 a recording cannot be read or a file cannot be written
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_report", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("bag", type=Path, nargs="+", help="folder of a recording, or its MCAP file; several: overlaid")
    about = "file of the intended motion of the tool, with times in ROS time: as for ik_demo, or a bag"
    about += " [trajectory.csv beside each recording, else the recorded targets]"
    result.add_argument("--truth", type=Path, help=about)
    result.add_argument("--json", action="store_true", help="print the figures for machines; several: a list")
    kinds = result.add_argument_group("pictures", "into report_<names>.<kind> in this folder, or where --out says")
    kinds.add_argument("--png", action="append_const", dest="kinds", const="png", help="the pages below each other")
    kinds.add_argument("--pdf", action="append_const", dest="kinds", const="pdf", help="vector pages")
    about = "one file for the browser, with tables, timeline, parameters and versions"
    kinds.add_argument("--html", action="append_const", dest="kinds", const="html", help=about)
    kinds.add_argument("--out", type=Path, help="PNG, PDF, HTML or SVG (the first page) file; an old one is replaced")
    add_options(result.add_argument_group("file of --truth"), motion=False)
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Write the report; return 0, or 2 when a file cannot be read or written."""
    options = parser().parse_args(arguments)
    from ik_node.report.atomic_write import write_report
    from ik_node.report.reported_run import read_reported_runs

    try:
        truth_format = format_from(options, motion=False)
        if options.truth is None:
            refuse_given(truth_format, "without --truth")
        reported_runs = read_reported_runs(options.bag, options.truth, truth_format)
        for path in _files(reported_runs, options.kinds or [], options.out):
            write_report(reported_runs, path)
            print(path, file=sys.stderr)  # stdout holds the report
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    print(_as_json(reported_runs, options.bag) if options.json else _as_text(reported_runs))
    return 0


def _files(reported_runs: Sequence[ReportedRun], kinds: Sequence[str], out: Path | None) -> tuple[Path, ...]:
    """Return the files to write: ``out``, and one beside it per kind that differs from its suffix."""
    from ik_node.report.atomic_write import check_suffix

    if out is not None:
        endings = [f".{kind}" for kind in kinds if f".{kind}" != out.suffix.lower()]
        asked = [out] if len(endings) < len(kinds) or not kinds else []
        for path in asked:
            check_suffix(path)
        return (*asked, *(out.with_suffix(ending) for ending in endings))
    names = [reported.name.replace("/", "_") for reported in reported_runs]
    more = [f"{len(names) - MOST_IN_NAME}_more"] if len(names) > MOST_IN_NAME else []
    stem = "_".join(["report", *names[:MOST_IN_NAME], *more])
    return tuple(Path(f"{stem}.{kind}") for kind in dict.fromkeys(kinds))


def _as_text(reported_runs: Sequence[ReportedRun]) -> str:
    from ik_node.report import as_text
    from ik_node.report.table import as_table

    return as_text(reported_runs[0].metrics) if len(reported_runs) == 1 else as_table(reported_runs)


def _as_json(reported_runs: Sequence[ReportedRun], bags: Sequence[Path]) -> str:
    """Return an object for one recording, a list of such for several."""
    from ik_node.report.text import report_plain

    every = [
        {"name": reported.name, "bag": str(bag), **report_plain(reported.metrics)}
        for reported, bag in zip(reported_runs, bags, strict=True)
    ]
    return json.dumps(every[0] if len(every) == 1 else every, indent=2, allow_nan=False)


if __name__ == "__main__":
    sys.exit(main())

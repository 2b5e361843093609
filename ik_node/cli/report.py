"""``ik_report BAG [BAG ...]``: figures and pictures of a recording, or of several beside each other."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError
from ik_node.report import FILE_NAME, as_plain, as_text
from ik_node.report.atomic_write import writer_for
from ik_node.report.reported_run import Subject, read_subjects
from ik_node.report.table import as_table

UNUSABLE = 2
MOST_IN_NAME = 3
"""Recordings that a file is called after."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="ik_report",
        description=__doc__,
        epilog="Exit code 0: reported; 2: a recording cannot be read, or a file cannot be written.",
    )
    result.add_argument("bag", type=Path, nargs="+", help="folder of a recording, or its MCAP file; several: overlaid")
    about = f"what the tool should have done [{FILE_NAME} beside each recording, else the recorded targets]"
    result.add_argument("--truth", type=Path, help=about)
    result.add_argument("--json", action="store_true", help="print the figures for machines; several: a list")
    kinds = result.add_argument_group("pictures", "into report_<names>.<kind> in this folder, or where --out says")
    kinds.add_argument("--png", action="append_const", dest="kinds", const="png", help="the pages below each other")
    kinds.add_argument("--pdf", action="append_const", dest="kinds", const="pdf", help="vector pages")
    about = "one file for the browser, with tables, timeline, parameters and versions"
    kinds.add_argument("--html", action="append_const", dest="kinds", const="html", help=about)
    kinds.add_argument("--out", type=Path, help="PNG, PDF, HTML or SVG (the first page) file; an old one is replaced")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Reports; 0, or 2 when something cannot be read or written."""
    options = parser().parse_args(arguments)
    try:
        subjects = read_subjects(options.bag, options.truth)
        for path in _files(subjects, options.kinds or [], options.out):
            writer_for(path)(subjects, path)
            # On the other channel: the first is for machines, perhaps.
            print(path, file=sys.stderr)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    print(_as_json(subjects, options.bag) if options.json else _as_text(subjects))
    return 0


def _files(subjects: Sequence[Subject], kinds: Sequence[str], out: Path | None) -> tuple[Path, ...]:
    """What is to be written: a kind that ``out`` does not end in gets its own ending."""
    if out is not None:
        endings = [f".{kind}" for kind in kinds if f".{kind}" != out.suffix.lower()]
        asked = [out] if len(endings) < len(kinds) or not kinds else []
        for path in asked:
            writer_for(path)
        return (*asked, *(out.with_suffix(ending) for ending in endings))
    names = [subject.name.replace("/", "_") for subject in subjects]
    more = [f"{len(names) - MOST_IN_NAME}_more"] if len(names) > MOST_IN_NAME else []
    stem = "_".join(["report", *names[:MOST_IN_NAME], *more])
    return tuple(Path(f"{stem}.{kind}") for kind in dict.fromkeys(kinds))


def _as_text(subjects: Sequence[Subject]) -> str:
    return as_text(subjects[0].report) if len(subjects) == 1 else as_table(subjects)


def _as_json(subjects: Sequence[Subject], bags: Sequence[Path]) -> str:
    """An object for one recording, a list of such for several."""
    every = [
        {"name": subject.name, "bag": str(bag), **as_plain(subject.report)}
        for subject, bag in zip(subjects, bags, strict=True)
    ]
    return json.dumps(every[0] if len(every) == 1 else every, indent=2, allow_nan=False)


if __name__ == "__main__":
    sys.exit(main())

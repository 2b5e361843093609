"""``ik_report``: figures and a picture of a recording."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError
from ik_node.recording.reader import load_run
from ik_node.report import FILE_NAME, Truth, as_json, as_text, figures, read_truth, truth_from_targets
from ik_node.report.picture import draw


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="ik_report", description=__doc__)
    result.add_argument("bag", type=Path, help="folder of a recording, or its MCAP file")
    about = f"what the tool should have done [{FILE_NAME} beside the recording, else the recorded targets]"
    result.add_argument("--truth", type=Path, help=about)
    result.add_argument("--json", action="store_true", help="print the figures for machines")
    result.add_argument("--out", type=Path, help="draw the picture into this PNG, PDF or SVG file")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the report; 0, or 1 when the recording cannot be read."""
    options = parser().parse_args(arguments)
    try:
        run = load_run(options.bag)
        report = figures(run, _truth(options.bag, options.truth) or truth_from_targets(run.targets, run.base_frame))
        if options.out is not None:
            draw(run, report, options.out)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(as_json(report) if options.json else as_text(report))
    return 0


def _truth(bag: Path, given: Path | None) -> Truth | None:
    """The truth that was given, or that lies beside the recording; None where there is none."""
    if given is not None:
        return read_truth(given)
    beside = bag.resolve().parent / FILE_NAME
    return read_truth(beside) if beside.is_file() else None


if __name__ == "__main__":
    sys.exit(main())

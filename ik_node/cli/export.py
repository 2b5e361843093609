"""Write a recorded run as a table with one row per control step, or for Foxglove and PlotJuggler."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError, InputError

SUFFIXES = (".csv", ".json")

EPILOG = """\
examples:
  ik_export my_run/bag steps.csv
  ik_export my_run/bag steps.csv steps.json

exit code: 0 written, 2 a file cannot be read or written
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_export", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("bag", type=Path, help="recording: a folder, or one of its files")
    result.add_argument("out", type=Path, nargs="*", help="new files, .csv or .json")
    result.add_argument(
        "--foxglove",
        type=Path,
        metavar="FOLDER",
        help="new folder: the messages of the run with /tf, /tf_static and the arm as markers; layouts beside them",
    )
    result.add_argument("--node", default="", help="full name of the node [the only one recorded]")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables; return 0, or 2 when a file cannot be read or written."""
    options = parser().parse_args(arguments)
    from ik_node.recording.export import write_csv, write_json
    from ik_node.recording.run_reader import load_run

    writers = dict(zip(SUFFIXES, (write_csv, write_json), strict=True))
    try:
        if not options.out and options.foxglove is None:
            raise InputError("expected a file to write, .csv or .json, or --foxglove FOLDER")
        for path in options.out:
            if path.suffix not in writers:
                raise InputError(f"'{path}' ends in '{path.suffix}'; valid: {', '.join(writers)}")
        if options.out:
            run = load_run(options.bag, options.node)
        for path in options.out:
            writers[path.suffix](run, path)
            print(f"{path}: {len(run.tick)} control steps")
        if options.foxglove is not None:
            _write_foxglove(options)
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _write_foxglove(options: argparse.Namespace) -> None:
    from ik_node.resources import config_folder
    from ik_node.viewer.foxglove import write_foxglove
    from ik_node.viewer.layouts import FOXGLOVE, PLOTJUGGLER

    folder = options.foxglove
    for missing in write_foxglove(options.bag, folder, config_folder(), options.node):
        print(missing)
    print(f"{folder}: Foxglove: open the .mcap file, import {FOXGLOVE}; PlotJuggler: load both with {PLOTJUGGLER}")


if __name__ == "__main__":
    sys.exit(main())

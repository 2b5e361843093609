"""``ik_export BAG``: a recorded run as a table, one row per tick."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError, InputError
from ik_node.recording.export import write_csv, write_json
from ik_node.recording.run_reader import load_run

WRITERS = {".csv": write_csv, ".json": write_json}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(prog="ik_export", description=__doc__)
    result.add_argument("bag", type=Path, help="recording: a folder, or one of its files")
    result.add_argument("out", type=Path, nargs="+", help="new files, .csv or .json")
    result.add_argument("--node", default="", help="full name of the node [the only one recorded]")
    return result


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Writes; 0, or 2 when something cannot be read or written."""
    options = parser().parse_args(arguments)
    try:
        for path in options.out:
            if path.suffix not in WRITERS:
                raise InputError(f"'{path}' ends in '{path.suffix}'; valid: {', '.join(WRITERS)}")
        run = load_run(options.bag, options.node)
        for path in options.out:
            WRITERS[path.suffix](run, path)
            print(f"{path}: {len(run.tick)} ticks")
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

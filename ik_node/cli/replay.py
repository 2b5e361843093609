"""``ik_replay BAG``: a recording through the controller again, and whether the same commands come of it."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from ik_node.errors import IkNodeError
from ik_node.recording.events import RecordedCalls
from ik_node.replay import text
from ik_node.replay.same import replay

PARTS, UNUSABLE = 1, 2


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="ik_replay",
        description=__doc__,
        epilog="Exit code 0: the same bits (elsewhere: the same but for rounding); 1: it parts; 2: it cannot be tried.",
    )
    result.add_argument("bag", type=Path, help="recording: a folder, or one of its files")
    result.add_argument("--node", default="", help="full name of the node [the only one recorded]")
    result.add_argument("--json", action="store_true", help="figures for machines")
    return result


def main(arguments: Sequence[str] | None = None) -> int:
    """Replays and says what came of it."""
    options = parser().parse_args(arguments)
    try:
        recorded = RecordedCalls(options.bag, options.node)
        begin = time.perf_counter()
        found = replay(recorded)
        took_s = time.perf_counter() - begin
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return UNUSABLE
    if options.json:
        print(json.dumps({**text.as_plain(found), "took_s": took_s}, indent=1))
    else:
        print(text.as_text(recorded, found, took_s))
    return 0 if found.holds else PARTS


if __name__ == "__main__":
    sys.exit(main())

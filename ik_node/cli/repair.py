"""``ik_repair BAG``: makes a recording whole that was cut off, and says what was lost."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError
from ik_node.interfaces.clock import NS
from ik_node.recording.mcap.metadata import METADATA_FILE
from ik_node.recording.mcap.repair import Repair, repair


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = argparse.ArgumentParser(
        prog="ik_repair", description=__doc__, epilog="Exit code 0: it is whole now; 2: it could not be made so."
    )
    result.add_argument("bag", type=Path, help="recording: a folder, or one MCAP file")
    return result


def as_text(done: Repair) -> str:
    """What there is to say of a repair."""
    if done.was_whole:
        return "whole: nothing to repair"
    lines = []
    for part in done.parts:
        until = f" until {part.end_ns / NS:.3f} s" if part.messages else ""
        kept = f"{part.messages} messages{until}"
        if part.was_whole:
            lines.append(f"{part.name}: whole, {kept}")
        else:
            removed = f"removed {part.removed_bytes} bytes of an unfinished record"
            lines.append(f"{part.name}: was cut off; kept {kept}; {removed}")
        if part.missing:
            lines.append(f"{part.name}: its writer had to leave out {part.missing} messages")
    lines += [f"{name}: empty, left alone and not listed" for name in done.ignored]
    if any(not part.was_whole for part in done.parts):
        lines.append(
            "lost: what had not been written when its writer died, at most recording.flush_period_s (0.1 s unless set)"
        )
    else:
        lines.append(f"lost: nothing; {METADATA_FILE} was missing and is written anew")
    return "\n".join(lines)


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Repairs, in place."""
    options = parser().parse_args(arguments)
    try:
        print(as_text(repair(options.bag)))
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

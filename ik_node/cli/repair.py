"""Complete a recording whose writer was killed, and print what was lost."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError

if TYPE_CHECKING:
    from ik_node.recording.mcap.repair import Repair

EPILOG = """\
example:
  ik_repair my_run/bag

exit code: 0 the recording is complete, 2 it cannot be completed
"""


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="ik_repair", description=__doc__, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    result.add_argument("bag", type=Path, help="recording: a folder, or one MCAP file")
    return result


def as_text(done: Repair) -> str:
    """Describe a repair, one line per file."""
    from ik_node.interfaces.clock import NS
    from ik_node.recording.mcap.metadata import METADATA_FILE

    if done.was_complete:
        return "complete: nothing to repair"
    lines = []
    for part in done.parts:
        until = f" until {part.end_ns / NS:.3f} s" if part.messages else ""
        kept = f"{part.messages} messages{until}"
        if part.was_complete:
            lines.append(f"{part.name}: complete, {kept}")
        else:
            removed = f"removed {part.removed_bytes} bytes of an unfinished record"
            lines.append(f"{part.name}: was cut off; kept {kept}; {removed}")
        if part.missing:
            lines.append(f"{part.name}: its writer dropped {part.missing} messages")
    lines += [f"{name}: empty, unchanged and not listed" for name in done.ignored]
    if any(not part.was_complete for part in done.parts):
        lines.append("lost: messages that were not written when the writer was killed, those of 0.1 s at most")
    else:
        lines.append(f"lost: nothing; {METADATA_FILE} was missing and has been written")
    return "\n".join(lines)


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Repair the recording in place; return 0, or 2 when it cannot be repaired."""
    options = parser().parse_args(arguments)
    from ik_node.recording.mcap.repair import repair

    try:
        print(as_text(repair(options.bag)))
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())

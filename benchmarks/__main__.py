"""``ik_benchmark NAME``: measurements, part by part; without a name, what there is."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError

PARTS = {
    "ik": ("benchmarks.ik", "inverse kinematics: random poses solved, time, published tables beside it"),
    "limits": ("benchmarks.limits", "the bounded optimum, hostile targets, lag and noise, singularities"),
    "obstacles": ("benchmarks.obstacles", "gradients, scenes driven past, obstacles on the path, speed"),
    "recording": ("benchmarks.recording", "what recording costs the loop, what a kill costs it, a long run"),
    "replay": ("benchmarks.replay", "runs of the node with every method, replayed bit for bit, and how fast"),
    "streams": ("benchmarks.streams", "streamed poses followed in process, beside P control and other rivals"),
    "tracking": ("benchmarks.tracking", "the whole loop on known and streamed targets, beside tuned rivals"),
}
"""Name -> module with a ``main(arguments) -> int``, and what it measures."""


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Hands the rest of the command line to the part of that name; 2 when it cannot be understood."""
    listing = "\n".join(f"  {name:<12}{summary}" for name, (_, summary) in PARTS.items())
    parser = argparse.ArgumentParser(
        prog="ik_benchmark",
        description=__doc__,
        epilog=f"parts:\n{listing}\n\n`ik_benchmark NAME --help` tells the options of a part.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", nargs="?", choices=list(PARTS), help="what to measure")
    parser.add_argument("rest", nargs=argparse.REMAINDER, help="options of that part")
    options = parser.parse_args(arguments)
    if options.name is None:
        parser.print_help()
        return 0
    try:
        return int(importlib.import_module(PARTS[options.name][0]).main(options.rest))
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

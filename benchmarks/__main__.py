"""Run a benchmark by name; without a name, list the benchmarks."""

from __future__ import annotations

import argparse
import importlib
import sys
from collections.abc import Sequence

from ik_node.cli.entry import command_line
from ik_node.errors import IkNodeError

BENCHMARKS = {
    "archive": "recordings replayed per minute, with 1 and 2 processes and Dask workers",
    "ik": "inverse kinematics: success rate and time on random poses, with published tables",
    "latency": "joint state out to command in over DDS, beside a node that echoes",
    "limits": "stress targets against joint limits, starts outside limits, lag and noise, singularities",
    "obstacles": "gradients, scenes beside the path, obstacles on the path, computing time",
    "recording": "cost of recording for the control loop, loss by a kill, a long run",
    "replay": "runs of the node with every method, replayed bit for bit, and replay speed",
    "scale": "computing time of a control step for 1 to 8 arms, in one process and in one each",
    "soak": "node, watchdog and simulated arm over DDS for minutes: missed steps, memory, threads, /dev/shm",
    "streams": "tracking of streamed poses in one process, with P control and other baselines",
    "task": "tolerances on spinning and moving targets: error, settling and time, beside pink and mink",
    "tick": "computing time of the control step by method, robot and obstacles, beside pink and mink",
    "tracking": "the whole loop on known and streamed targets, with tuned baselines",
}
"""Module with a ``main(arguments) -> int`` -> what it measures."""


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Pass the rest of the command line to a benchmark; return its exit code, 2 for invalid arguments."""
    listing = "\n".join(f"  {name:<12}{summary}" for name, summary in BENCHMARKS.items())
    parser = argparse.ArgumentParser(
        prog="ik_benchmark",
        description=__doc__,
        epilog=f"benchmarks:\n{listing}\n\n`ik_benchmark NAME --help` prints the options of a benchmark.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", nargs="?", choices=list(BENCHMARKS), help="benchmark to run")
    parser.add_argument("rest", nargs=argparse.REMAINDER, help="options of that benchmark")
    options = parser.parse_args(arguments)
    if options.name is None:
        parser.print_help()
        return 0
    try:
        return int(importlib.import_module(f"benchmarks.{options.name}").main(options.rest))
    except IkNodeError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())

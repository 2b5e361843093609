"""Command lines of the executables that are ROS nodes: their own options, beside the arguments for ROS."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

BEGIN, END = "--ros-args", "--"


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """Parse the options of the executable itself; exits with a message for an option that neither it nor ROS has.

    Args:
        parser: Options of the executable.
        arguments: Command line without the program's name; None takes that of the process.
    """
    return parser.parse_args(_own(sys.argv[1:] if arguments is None else arguments))


def node_parser(name: str, description: str | None, epilog: str) -> argparse.ArgumentParser:
    """Return the parser of a node's executable; it has no option but ``--help``."""
    return argparse.ArgumentParser(
        prog=name,
        usage=f"{name} [-h] [--ros-args ...]",
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _own(arguments: Sequence[str]) -> list[str]:
    """Drop each section from ``--ros-args`` to ``--`` or to the end, as ROS 2 defines it."""
    own, for_ros = [], False
    for argument in arguments:
        if for_ros:
            for_ros = argument != END
        elif argument == BEGIN:
            for_ros = True
        else:
            own.append(argument)
    return own

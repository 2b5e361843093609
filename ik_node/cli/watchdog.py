"""``ik_watchdog``: stops the arm when the node was killed or hangs."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ik_node.cli.entry import command_line


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the watchdog until a signal; returns the exit code."""
    from ik_node.ros.spin import run
    from ik_node.ros.watchdog_node import WatchdogNode

    return run(WatchdogNode, WatchdogNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv))

"""``ik_simulator``: a simulated robot as a node."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ik_node.cli.entry import command_line


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the simulated robot until a signal; returns the exit code."""
    from ik_node.ros.simulator_node import SimulatorNode
    from ik_node.ros.spin import run

    return run(SimulatorNode, SimulatorNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv))

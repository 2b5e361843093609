"""``ik_node``: the node."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ik_node.cli.entry import command_line


@command_line
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the node until a signal; returns the exit code."""
    from ik_node.ros.node import IkNode
    from ik_node.ros.spin import run

    return run(IkNode, IkNode.finish, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv))

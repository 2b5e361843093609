"""``ik_node`` with errors in its own code, which no input causes, each once on a signal.

SIGUSR1: an exception in the next control step. SIGUSR2: the next control step has a result that is not finite.
"""

from __future__ import annotations

import signal
import sys
from typing import Any

import numpy as np

from ik_node.cli.node import main
from ik_node.robot.robot import Robot

EVALUATE = Robot.evaluate
PENDING: list[int] = []


def evaluate(robot: Robot, position: Any) -> Any:
    """As Robot.evaluate, but with the requested error once."""
    if not PENDING:
        return EVALUATE(robot, position)
    if PENDING.pop() == signal.SIGUSR1:
        raise RuntimeError("an error in the code")
    return EVALUATE(robot, np.full_like(position, np.nan))


if __name__ == "__main__":
    # The error has to be inside the process of the node; the type checker permits no replacement of a method.
    Robot.evaluate = evaluate  # type: ignore[assignment, method-assign]
    for number in (signal.SIGUSR1, signal.SIGUSR2):
        signal.signal(number, lambda received, _: PENDING.append(received))
    sys.exit(main())

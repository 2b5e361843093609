"""A fault as a declared record, and the choice of faults for one run.

A fault has a cause, and what is right: the mode and the status text that follow, the longest time to zero velocity, and
the way back. ``--exhaustive`` runs all rows; otherwise a seed chooses them (``--fault-seed``), so that all rows are
covered over seeds.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import pytest

if TYPE_CHECKING:
    from rig import Rig

METHODS = ("plain", "inertia_weighted", "obstacle_gradient", "gravity_gradient", "joint_weighted")
TIMEOUT_S = 0.4
"""state.timeout_s of the nodes under test; the test process, which sends the joint states, is late now and then."""
MARGIN_S = 0.6
"""Added to each longest time to zero, for a busy machine. What stands in the column is the measured time."""

GOES_ON, HOLDS, STOPPED, PAUSED, FAULT, ENDED = "tracking", "holding", "stopped", "paused", "fault", "ended"
"""Expected modes; ``ended``: the process has ended."""
ITSELF, UNPAUSE, RESET, START, NOTHING = "by itself", "after pause false", "after reset", "after a new start", "-"
"""Ways back to motion after the cause is gone."""


SILENCES = (
    "no joint state for",
    "of panda",
    "the node was held up",
    "joint states",
    "far outside",
    "joint 'panda",
    "300",
)
"""Begin of the expected text of such a stop."""
BETWEEN_SILENCES_S = 10.5
"""Time after which a silence is not the repetition of the last one: RELAPSE_S of the controller, and a margin."""


class Right(NamedTuple):
    """What has to follow a fault."""

    mode: str = GOES_ON
    text: str = ""
    """Part of the status text; empty when nothing has to be reported."""
    zero_s: float | None = None
    """Longest time from the fault to zero velocity (``holding``: to that mode), less the margin; None: not checked."""
    at_once: bool = False
    """True when the velocity may become zero without a ramp."""
    back: str = ITSELF

    @property
    def is_silence(self) -> bool:
        """True for a stop for lack of joint states, or of computing time: one that repeats has a longer way back."""
        return self.mode == STOPPED and self.text.startswith(SILENCES)


class Fault(NamedTuple):
    """One fault of a moving arm."""

    name: str
    cause: Callable[[Rig], object]
    right: Right
    case: str = ""
    """Number of the case in the collections of reported faults: F (faults) or W (field)."""
    undo: Callable[[Rig], object] | None = None
    """In addition to restoring all inputs."""


def spread(faults: Sequence[Fault]) -> list[Fault]:
    """The faults in an order in which silences are evenly spaced."""
    silences = [fault for fault in faults if fault.right.is_silence]
    others = [fault for fault in faults if not fault.right.is_silence]
    placed = [(position / max(len(silences), 1), fault) for position, fault in enumerate(silences)]
    placed += [((position + 0.5) / max(len(others), 1), fault) for position, fault in enumerate(others)]
    return [fault for _, fault in sorted(placed, key=lambda entry: entry[0])]


T = TypeVar("T")


def choose(config: pytest.Config, what: str, rows: Sequence[T], count: int) -> list[T]:
    """All rows with ``--exhaustive``, else ``count`` of them, chosen by the seed and the name ``what``."""
    if config.getoption("--exhaustive"):
        return list(rows)
    numbers = sorted(_generator(config, what).sample(range(len(rows)), min(count, len(rows))))
    return [rows[number] for number in numbers]


def chosen_methods(config: pytest.Config, what: str) -> list[str]:
    """All methods with ``--exhaustive``, else one."""
    return choose(config, f"{what} method", METHODS, 1)


def _generator(config: pytest.Config, what: str) -> random.Random:
    return random.Random(f"{config.getoption('--fault-seed')} {what}")

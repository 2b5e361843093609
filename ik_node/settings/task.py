"""The parameters of the task: which part of the pose of the tool matters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from ik_node.errors import SettingsError
from ik_node.settings.schema import Group, setting

TASK_FRAMES = ("tool", "base")
"""Values of ``task.frame``; implemented in :mod:`ik_node.math.task_tolerance`."""


@dataclass(frozen=True)
class TaskSettings(Group):
    """Which part of the pose of the tool matters."""

    prefix: ClassVar[str] = "task"
    tolerance: tuple[float, ...] = setting(
        (0.0,) * 6,
        "Half-widths x y z rx ry rz about the target: 0 is followed exactly, .inf is free, between is a band.",
        "m, m, m, rad, rad, rad",
        0.0,
        math.inf,
        size=6,
    )
    frame: str = setting(
        "tool", "Axes of the tolerance: those of the target, or those of base_frame.", choices=TASK_FRAMES
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if all(math.isinf(width) for width in self.tolerance[:3]) and min(self.tolerance[3:]) >= math.pi:
            raise SettingsError("task.tolerance leaves all six components free; at least one has to be finite")

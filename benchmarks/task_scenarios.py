"""Tasks of ``ik_benchmark task``: arm, tolerance, and a target that moves in what is followed and in what is free."""

from __future__ import annotations

from math import cos, inf, pi, sin
from typing import NamedTuple

import numpy as np

from benchmarks.task_rivals import Costs
from ik_node.math import se3
from ik_node.math.types import Array

PERIOD_S = 4.0
"""Of the motion of a target."""
TILT_RAD = np.deg2rad(30.0)
"""Start of the tool from a target that stands still, about x of the axes of the tolerance."""
ALL = (1.0, 1.0, 1.0)
WHOLE = Costs("whole pose", ALL, ALL)


class Scenario(NamedTuple):
    """A task."""

    name: str
    robot: str
    tolerance: tuple[float, ...]
    frame: str
    rates: tuple[float, ...]
    """Speeds of the target in what is free: rad/s, or m/s at most along a free translation."""
    radius_m: float
    """Of the circle in x and y, or half the length of the line in x, in the axes of the tolerance."""
    is_line: bool
    sway_rad: float
    """Amplitude of the rotation about x of the axes of the tolerance."""
    rivals: tuple[Costs, ...]

    def pose(self, start: Array, time_s: float, rate: float, moving: bool, tilt_rad: float = 0.0) -> Array:
        """T_sd (4, 4) at a time; ``start`` is T_sb of the tool at time 0.

        Args:
            start: (4, 4).
            time_s: Time, s.
            rate: One of ``rates``.
            moving: Whether the target moves in what is followed.
            tilt_rad: Constant rotation about x, rad.

        Returns:
            The target.
        """
        phase = 2.0 * pi * time_s / PERIOD_S
        shift, tilt = np.zeros(3), tilt_rad
        if moving:
            shift[:] = (0.0, self.radius_m * sin(phase), 0.0 if self.is_line else self.radius_m * (1.0 - cos(phase)))
            tilt += self.sway_rad * sin(phase)
        turn = se3.exp_rotation(np.array((tilt, 0.0, 0.0)))
        if self.tolerance[0] == inf:
            # The axes of the tolerance are those of the target, so that its own x is what is free.
            shift += turn @ np.array((SLIDE_M * sin(rate * time_s / SLIDE_M), 0.0, 0.0))
            spin = np.eye(3)
        else:
            spin = se3.exp_rotation(np.array((0.0, 0.0, rate * time_s)))
        pose: Array = start.copy()
        if self.frame == "base":
            pose[:3, 3] += shift
            pose[:3, :3] = spin @ turn @ start[:3, :3]
        else:
            pose[:3, 3] += start[:3, :3] @ shift
            pose[:3, :3] = start[:3, :3] @ turn @ spin
        return pose


SLIDE_M = 0.1
"""Amplitude of the target along a free translation."""
POINTING = Scenario(
    "pointing", "ur5", (0.0, 0.0, 0.0, 0.0, 0.0, inf), "tool", (0.0, 2.0, 20.0), 0.05, False, 0.2,
    (Costs("masked", ALL, (1.0, 1.0, 0.0)), Costs("axis", ALL, (0.0, 0.0, 0.0), aligns_z=True)),
)  # fmt: skip
SEAM = Scenario(
    "seam", "ur5", (inf, 0.0, 0.0, 0.0, 0.0, 0.0), "tool", (0.0, 0.3), 0.05, False, 0.2,
    (Costs("masked", (0.0, 1.0, 1.0), ALL),),
)  # fmt: skip
BAND = Scenario(
    "band", "ur5", (0.0, 0.0, 0.0, 0.2, 0.2, inf), "tool", (0.0, 2.0, 20.0), 0.05, False, 0.4,
    (Costs("masked", ALL, (1.0, 1.0, 0.0)), Costs("position", ALL, (0.0, 0.0, 0.0)),
     Costs("axis", ALL, (0.0, 0.0, 0.0), aligns_z=True)),
)  # fmt: skip
SO101 = Scenario(
    "so101 line", "so101", (0.0, 0.0, 0.0, 0.0, 0.0, inf), "base", (0.0, 2.0, 20.0), 0.05, True, 0.1,
    (WHOLE, Costs("soft", ALL, (0.01, 0.01, 0.01)), Costs("axis", ALL, (0.0, 0.0, 0.0), aligns_z=True)),
)  # fmt: skip
SCENARIOS = {scenario.name.split()[0]: scenario for scenario in (POINTING, SEAM, BAND, SO101)}

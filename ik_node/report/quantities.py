"""Names, units and factors with which the report and the viewer display a quantity."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

NOT_AVAILABLE = "-"


class DisplayedQuantity(NamedTuple):
    """A quantity as it is displayed."""

    name: str
    unit: str = ""
    factor: float = 1.0
    """From SI units to ``unit``."""
    digits: int = 3
    """After the decimal point."""

    @property
    def label(self) -> str:
        """Name with unit: the label of a row of a table."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def title(self) -> str:
        """Label with a capital letter: the title of a plot."""
        return self.label[0].upper() + self.label[1:]

    def scaled(self, values: Any) -> Any:
        """Values in SI units -> values in ``unit``."""
        return self.factor * values

    def text(self, value: float, not_available: str = NOT_AVAILABLE, with_unit: bool = False) -> str:
        """A value in SI units as text; ``not_available`` if it is not finite."""
        if not math.isfinite(value):
            return not_available
        number = f"{self.factor * value:.{self.digits}f}"
        return f"{number} {self.unit}".rstrip() if with_unit else number


TOOL_TO_TRAJECTORY = "tool to trajectory"
REFERENCE_TO_TRAJECTORY = "reference to trajectory"
"""Part of that error: what targets and smoothing did."""
TOOL_TO_REFERENCE = "tool to reference"
"""The other part: what the control law and the limits did."""
POSITION_ERROR = DisplayedQuantity(f"position error, {TOOL_TO_TRAJECTORY}", "mm", 1e3)
ORIENTATION_ERROR = DisplayedQuantity(f"orientation error, {TOOL_TO_TRAJECTORY}", "mrad", 1e3)
REFERENCE_POSITION_ERROR = DisplayedQuantity(f"position error, {REFERENCE_TO_TRAJECTORY}", "mm", 1e3)
REFERENCE_ORIENTATION_ERROR = DisplayedQuantity(f"orientation error, {REFERENCE_TO_TRAJECTORY}", "mrad", 1e3)
TOOL_POSITION_ERROR = DisplayedQuantity(f"position error, {TOOL_TO_REFERENCE}", "mm", 1e3)
TOOL_ORIENTATION_ERROR = DisplayedQuantity(f"orientation error, {TOOL_TO_REFERENCE}", "mrad", 1e3)
JOINT_SPEED = DisplayedQuantity("joint velocity command", "% of limit", 100.0, 1)
SMALLEST_SINGULAR_VALUE = DisplayedQuantity("smallest singular value", "m", digits=4)
SCALE = DisplayedQuantity("task scale s")
CLEARANCE = DisplayedQuantity("clearance", "mm", 1e3, 1)
TRUNCATED_LINEAR = DisplayedQuantity("truncated twist, linear", "mm/s", 1e3, 2)
TRUNCATED_ANGULAR = DisplayedQuantity("truncated twist, angular", "mrad/s", 1e3, 2)
HELD_BACK_LINEAR = DisplayedQuantity("twist held back, linear", "mm/s", 1e3, 2)
OFF_DIRECTION_LINEAR = DisplayedQuantity("motion off the direction, linear", "mm/s", 1e3, 2)
OFF_DIRECTION_ANGULAR = DisplayedQuantity("motion off the direction, angular", "mrad/s", 1e3, 2)
OBSTACLE_CLEARANCE = DisplayedQuantity("clearance to obstacles", "mm", 1e3, 1)
SELF_CLEARANCE = DisplayedQuantity("clearance between links", "mm", 1e3, 1)
KINETIC_ENERGY = DisplayedQuantity("kinetic energy of the command", "J", digits=4)
POTENTIAL = DisplayedQuantity("potential h(q)", "J")
GRAVITATIONAL_ENERGY = DisplayedQuantity("gravitational energy", "J")
REPULSION = DisplayedQuantity("repulsion of near pairs", "J", digits=4)
NULL_SPACE_SPEED = DisplayedQuantity("null-space speed |N qd|", "rad/s", digits=4)
"""With prismatic joints m/s is counted as rad/s."""
COMPUTING = DisplayedQuantity("computing time", "ms", 1e3)
MULTIPLIER_TASK_LINEAR = DisplayedQuantity("λ task, linear", "N s")
"""The multiplier has one presentation everywhere: its task term is a momentum, its potential term divided by the gain k
a wrench on the tool. For the methods :data:`UNWEIGHTED` by masses the task term has no unit."""
MULTIPLIER_TASK_ANGULAR = DisplayedQuantity("λ task, angular", "N m s")
MULTIPLIER_POTENTIAL_LINEAR = DisplayedQuantity("λ potential / k, force", "N")
MULTIPLIER_POTENTIAL_ANGULAR = DisplayedQuantity("λ potential / k, torque", "N m")
UNWEIGHTED = ("plain", "joint_weighted")
"""The methods without mass weighting."""

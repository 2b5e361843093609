"""Tolerance of a task: which part of the pose of the tool matters, and how closely.

A target T_sd with a tolerance stands for a family of poses. Each of six components, x y z and rx ry rz, has a
half-width: 0 is followed exactly, infinity is free, and a number between is a band about the target. The frame states
the axes of the components:

- ``tool``: the axes of the target, with which those of the tool coincide on arrival. A spin of the target in a free
  direction does not turn them: with one free rotation they are turned about its axis, with three free rotations
  altogether, to be nearest to those of the tool.
- ``base``: the axes of the base frame, through the tool point.

The rotation part is defined by the free components: none or all three, by the rotation vector; one, by the swing,
the least rotation that brings its axis onto that of the target; two, by the twist about the third axis, which is held.
:mod:`ik_node.math.task_error` computes the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, pi

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ik_node.errors import InputError, UnknownNameError
from ik_node.math.task_error import LOG, MEMBER_AXES, SWING, TARGET_AXES, TOOL_AXES, TWIST, TaskForm

FRAMES = ("tool", "base")
"""Values of ``frame``."""
COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the components, in order."""
EXACT = (0.0,) * 6
"""Half-widths of a task in which the whole pose matters."""


@dataclass(frozen=True)
class TaskTolerance:
    """Half-widths of the six components, and the frame of their axes."""

    half_widths: Sequence[float] = EXACT
    """x, y, z in m, rx, ry, rz in rad; 0: exact, infinite: free. A rotation of pi or more is free."""
    frame: str = "tool"
    """One of :data:`FRAMES`."""

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InputError: Not six numbers >= 0, or all six are free.
            UnknownNameError: ``frame`` is not one of :data:`FRAMES`.
        """
        if self.frame not in FRAMES:
            raise UnknownNameError("task frame", str(self.frame), FRAMES)
        numbers = _numbers(self.half_widths)
        if len(numbers) != 6:
            raise InputError(f"task tolerance has {len(numbers)} numbers; expected 6: {' '.join(COMPONENTS)}")
        for name, number in zip(COMPONENTS, numbers, strict=True):
            if isnan(number) or number < 0.0:
                raise InputError(f"task tolerance {name} is {number}; expected a number >= 0, or inf for free")
        turns = [inf if number >= pi else number for number in numbers[3:]]
        widths = (*(number + 0.0 for number in numbers[:3]), *(number + 0.0 for number in turns))
        if all(number == inf for number in widths):
            raise InputError("task tolerance leaves all six components free; at least one has to be finite")
        object.__setattr__(self, "half_widths", widths)

    @property
    def is_exact(self) -> bool:
        """True if the whole pose is followed exactly."""
        return tuple(self.half_widths) == EXACT

    @property
    def exact(self) -> NDArray[np.bool_]:
        """(6,), bool: components that are followed exactly."""
        return np.asarray([number == 0.0 for number in self.half_widths])

    @property
    def free(self) -> NDArray[np.bool_]:
        """(6,), bool: components that are free."""
        return np.isinf(self.half_widths)

    @property
    def form(self) -> TaskForm:
        """The tolerance as compiled functions take it."""
        widths = np.array(self.half_widths)
        free, loose = np.flatnonzero(self.free[3:]), np.flatnonzero(widths[3:] > 0.0)
        rotation, axis = LOG, 2
        if len(free) == 1 or (len(free) == 0 and len(loose) == 1):
            rotation, axis = SWING, int(free[0] if len(free) else loose[0])
        elif len(free) == 2:
            rotation, axis = TWIST, int(3 - free.sum())
        across = [index for index in range(3) if index != axis]
        others = [3 + index for index in across] if rotation == SWING else [3, 4, 5]
        linear = MEMBER_AXES if len(free) == 1 else TOOL_AXES if len(free) == 3 else TARGET_AXES
        return TaskForm(
            widths,
            self.frame == "base",
            rotation,
            axis,
            bool(self.exact[others].all()),
            linear,
            not _isotropic(widths[:3]),
            not _isotropic(widths[across]),
        )

    def text(self) -> str:
        """The half-widths as one line, as ``ik_solve --tolerance`` takes them."""
        return " ".join(f"{number:g}" for number in self.half_widths)


def _numbers(values: ArrayLike) -> list[float]:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty((0, 0))
    if array.ndim != 1:
        raise InputError(f"task tolerance is {values!r}; expected 6 numbers: {' '.join(COMPONENTS)}")
    return [float(number) for number in array]


def _isotropic(widths: NDArray[np.float64]) -> bool:
    """Whether a rotation of the axes does not change the part of the error that counts: all exact, or all free."""
    return bool((widths == 0.0).all() or np.isinf(widths).all())

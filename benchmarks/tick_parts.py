"""``ik_benchmark tick --parts``: where the time of a control step goes.

Functions are replaced by ones that take the time of each call. The time of calls within a call is subtracted, so that
the parts add up to the step. Taking the time costs some 0.2 us per call, which the parts contain.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ik_node.collision.monitor import CollisionMonitor
from ik_node.control import controller
from ik_node.control.controller import Controller
from ik_node.control.joint_states import JointStateMerger
from ik_node.control.velocity_controller import VelocityController
from ik_node.differential_ik import solver
from ik_node.differential_ik.selected_method import SelectedMethod
from ik_node.differential_ik.solver import DifferentialIkSolver
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.targets.arbiter import TargetArbiter

PARTS: tuple[tuple[Any, str, str], ...] = (
    (Controller, "on_joint_state", "state machine, timing"),
    (JointStateMerger, "add", "joint state: order, plausibility"),
    (TargetArbiter, "advance", "target: filter of the stream"),
    (Robot, "pose", "forward kinematics (Pinocchio)"),
    (Robot, "evaluate", "Jacobian (Pinocchio)"),
    (VelocityController, "compute", "control law"),
    (DifferentialIkSolver, "solve_twist", "solver, in Python"),
    (CollisionMonitor, "update", "distances, dampers, potential"),
    (SelectedMethod, "cost", "weight and gradient of the method"),
    (solver, "solve_step", "compiled step: SVD, closed form, limits"),
    (controller, "report_step", "status"),
    (controller, "closed_loop_step", "Step"),
)
"""Class or module, name of the function, name of the part."""


class PartTimes:
    """Times of the parts of control steps, in ns, while it is open."""

    def __init__(self) -> None:
        """Replaces the functions until :meth:`close`."""
        self.parts: dict[str, list[float]] = {}
        self._inner = [0]
        self._now: dict[str, float] = {}
        self._replaced = [(owner, name, getattr(owner, name)) for owner, name, _ in PARTS]
        for owner, name, part in PARTS:
            self._replace(owner, name, part)

    def _replace(self, owner: Any, name: str, part: str) -> None:
        function: Callable[..., Any] = getattr(owner, name)
        inner, now, clock = self._inner, self._now, time.perf_counter_ns

        def timed(*arguments: Any, **named: Any) -> Any:
            inner.append(0)
            begin = clock()
            try:
                return function(*arguments, **named)
            finally:
                took = clock() - begin
                now[part] = now.get(part, 0.0) + took - inner.pop()
                inner[-1] += took

        setattr(owner, name, timed)

    def next_step(self) -> None:
        """Adds the times of the last control step."""
        for part, took in self._now.items():
            self.parts.setdefault(part, []).append(took)
        self._now.clear()

    def close(self) -> None:
        """Puts the functions back."""
        for owner, name, function in self._replaced:
            setattr(owner, name, function)

    def table(self) -> str:
        """10th percentile and median of each part, us."""
        rows = [(part, 1e-3 * np.quantile(took, (0.1, 0.5))) for part, took in self.parts.items()]
        rows.sort(key=lambda entry: -float(entry[1][0]))
        total: Array = np.sum([times for _, times in rows], axis=0)
        lines = [f"    {part:42}{times[0]:8.1f}{times[1]:8.1f}" for part, times in (*rows, ("sum", total))]
        return "\n".join([f"    {'part':42}{'10 %':>8}{'median':>8} us", *lines])

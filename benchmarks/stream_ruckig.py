"""Ruckig (Berscheid and Kroeger, RSS 2021) as a baseline of ``ik_benchmark streams``: time-optimal with limited jerk.

At each control step it plans, per axis, to the newest sample extrapolated with the slope from the previous one, and
the tool follows the first step of the plan. It is optional: ``pip install -r benchmarks/requirements.txt``.
"""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

from benchmarks.stream_baselines import VelocityFollower
from ik_node.interfaces.clock import NS, Stamped
from ik_node.math.quaternion import (
    ZERO,
    Quaternion,
    Vector,
    add,
    conjugate,
    difference,
    from_matrix,
    from_rotation_vector,
    length,
    multiply,
    normalised,
    scaled,
    to_rotation_vector,
)
from ik_node.math.types import Array
from ik_node.settings.groups import TargetSettings
from ik_node.targets.bounds import stream_bounds
from ik_node.targets.jerk_limited_filter import Bounds
from ik_node.targets.stream.sampling_clock import SamplingClock, reset, updated


class TimeOptimal(VelocityFollower):
    """The time-optimal motion to the extrapolated sample and its slope, within the speed and acceleration bounds."""

    def __init__(self, settings: TargetSettings, jerk_part: float) -> None:
        """Raises ImportError without the package ruckig; ``jerk_part`` is the fraction of ``target.max_jerk``."""
        super().__init__()
        self._library: Any = import_module("ruckig")  # imported here because it is optional
        self._bounds = stream_bounds(settings)
        self._inputs = [self._input(bounds, jerk_part) for bounds in self._bounds]
        self._planner: Any = None
        self._sample: tuple[Vector, Quaternion] | None = None
        self._slopes = (ZERO, ZERO)
        self._clock = SamplingClock()

    @staticmethod
    def available() -> bool:
        """Return whether the package is installed."""
        return find_spec("ruckig") is not None

    def _input(self, bounds: Bounds, jerk_part: float) -> Any:
        result = self._library.InputParameter(3)
        result.max_velocity = [bounds.speed] * 3
        result.max_acceleration = [bounds.acceleration] * 3
        result.max_jerk = [jerk_part * bounds.jerk] * 3
        return result

    def add(self, pose_sd: Array, stamped: Stamped) -> None:
        """Take the sample; older ones and repeated stamps are ignored."""
        x, y, z = pose_sd[:3, 3].tolist()
        orientation = from_matrix(pose_sd)
        if self._sample is None:
            self._clock = reset(self._clock, stamped.time_ns)
        elif stamped.time_ns <= self._clock.time_ns:
            return
        else:
            dt = (stamped.time_ns - self._clock.time_ns) / NS
            self._clock = updated(self._clock, stamped.time_ns)
            dt = max(dt, 0.5 * self._clock.period_s)
            turn = to_rotation_vector(multiply(orientation, conjugate(self._sample[1])))
            slopes = (scaled(difference((x, y, z), self._sample[0]), 1.0 / dt), scaled(turn, 1.0 / dt))
            jump = any(length(slope) > bounds.speed for slope, bounds in zip(slopes, self._bounds, strict=True))
            self._slopes = (ZERO, ZERO) if jump else slopes
        self._sample = ((x, y, z), orientation)

    def command(self, position: Vector, orientation: Quaternion, time_ns: int, hold_s: float) -> tuple[Vector, Vector]:
        """Return the mean velocity over the first step of the plan."""
        if self._sample is None:
            return ZERO, ZERO
        if self._planner is None:
            self._planner = self._library.Ruckig(3, hold_s)
        age_s = min((time_ns - self._clock.time_ns) / NS, 2.0 * self._clock.period_s)
        goal = (
            add(self._sample[0], scaled(self._slopes[0], age_s)),
            normalised(multiply(from_rotation_vector(scaled(self._slopes[1], age_s)), self._sample[1])),
        )
        errors = (
            difference(goal[0], position),
            to_rotation_vector(multiply(goal[1], conjugate(orientation))),
        )
        command = []
        for plan, error, slope in zip(self._inputs, errors, self._slopes, strict=True):
            plan.current_position = [0.0, 0.0, 0.0]
            plan.target_position = list(error)
            plan.target_velocity = list(slope)
            output = self._library.OutputParameter(3)
            try:
                self._planner.update(plan, output)
            except self._library.RuckigError:  # it finds no plan: it keeps the velocity for this step
                v = tuple(plan.current_velocity)
                plan.current_acceleration = [0.0, 0.0, 0.0]
            else:
                x, y, z = output.new_position
                v = (x / hold_s, y / hold_s, z / hold_s)
                plan.current_velocity = output.new_velocity
                plan.current_acceleration = output.new_acceleration
            command.append(v)
        return command[0], command[1]

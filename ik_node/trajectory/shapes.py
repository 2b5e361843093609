"""Trajectories from formulas: rest to rest, with three continuous derivatives in time.

Every shape begins exactly at a given start pose, so that an arm at rest there can follow from the first step on.
Displacements are along the axes of the base frame {s}; turns are about the axes of the start pose's own frame.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from ik_node.errors import InputError
from ik_node.interfaces.motion import Trajectory
from ik_node.math import se3
from ik_node.math.types import Array

PhaseCurve = Callable[[float], tuple[tuple[float, float, float], tuple[float, float, float]]]
"""Phase in rad -> displacement in {s} [m], rotation vector in the start pose's frame [rad]; both 0 at phase 0."""

PEAK_SPEED = 35.0 / 16.0
"""Largest slope of :func:`rest_to_rest`."""
PEAK_ACCELERATION = 84.0 / 25.0 * math.sqrt(5.0)
"""Largest second derivative of :func:`rest_to_rest`."""


def rest_to_rest(u: float) -> float:
    """From 0 to 1 while ``u`` goes from 0 to 1: 35 u^4 - 84 u^5 + 70 u^6 - 20 u^7, the lowest polynomial whose first
    three derivatives vanish at both ends. Constant outside."""
    u = min(max(u, 0.0), 1.0)
    return u**4 * (35.0 + u * (-84.0 + u * (70.0 - 20.0 * u)))


@dataclass(frozen=True)
class Cruise:
    """A phase that accelerates, moves at a constant rate and decelerates, with three continuous derivatives."""

    total: float
    """Phase at the end, rad."""
    rate: float
    """Constant phase rate, rad/s."""
    ramp_s: float
    """Duration of acceleration and of deceleration."""

    def __post_init__(self) -> None:
        for name in ("total", "rate", "ramp_s"):
            _positive(name, getattr(self, name))
        if self.total < self.rate * self.ramp_s:
            raise InputError(f"ramp_s is {self.ramp_s:g}; at most {self.total / self.rate:g} s fits into the motion")

    @property
    def duration_s(self) -> float:
        """Total duration; both ramps together cover the phase of one ramp at full rate."""
        return self.total / self.rate + self.ramp_s

    def phase(self, time_s: float) -> float:
        """Phase in rad, from 0 to ``total``; constant outside 0..duration_s."""
        left_s = self.duration_s - time_s
        if time_s <= left_s:
            return self._from_rest(time_s)
        return self.total - self._from_rest(left_s)

    def _from_rest(self, time_s: float) -> float:
        """Integral of the rate, which rises by the quintic 10 u^3 - 15 u^4 + 6 u^5."""
        u = max(time_s, 0.0) / self.ramp_s
        if u >= 1.0:
            return self.rate * (time_s - 0.5 * self.ramp_s)
        return self.rate * self.ramp_s * u**4 * (2.5 + u * (-3.0 + u))


@dataclass(frozen=True)
class CurveTrajectory:
    """A curve over the phase of a :class:`Cruise`, relative to a start pose."""

    start_pose: Array
    """T_sd at the start, (4, 4)."""
    curve: PhaseCurve
    timing: Cruise

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.timing.duration_s

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""
        displacement, turn = self.curve(self.timing.phase(time_s))
        pose: Array = self.start_pose.copy()
        pose[:3, 3] += displacement
        pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(np.array(turn))
        return pose


@dataclass(frozen=True)
class StraightLine:
    """A straight line with the shortest turn, by :func:`rest_to_rest`."""

    from_pose: Array
    """T_sd at the start, (4, 4)."""
    to_pose: Array
    """T_sd at the end, (4, 4)."""
    duration_s: float
    """Length in seconds; 0: at rest at ``to_pose``."""

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""
        if time_s >= self.duration_s:
            return np.array(self.to_pose)
        part = rest_to_rest(time_s / self.duration_s)
        pose: Array = self.from_pose.copy()
        pose[:3, 3] += part * (self.to_pose[:3, 3] - self.from_pose[:3, 3])
        pose[:3, :3] = pose[:3, :3] @ se3.exp_rotation(part * _turn(self.from_pose, self.to_pose))
        return pose


@dataclass(frozen=True)
class Sequence:
    """Trajectories one after the other."""

    parts: tuple[Trajectory, ...]

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return sum(part.duration_s for part in self.parts)

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""
        starts = [0.0, *accumulate(part.duration_s for part in self.parts[:-1])]
        index = max(bisect_right(starts, time_s) - 1, 0)
        return self.parts[index].pose(time_s - starts[index])


@dataclass(frozen=True)
class ScaledTrajectory:
    """A trajectory whose displacement and turn relative to its start are a multiple of another's."""

    trajectory: Trajectory
    scale: float

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return self.trajectory.duration_s

    def pose(self, time_s: float) -> Array:
        """T_sd(t), (4, 4); constant outside 0..duration_s."""
        start, pose = self.trajectory.pose(0.0), np.array(self.trajectory.pose(time_s))
        pose[:3, 3] = start[:3, 3] + self.scale * (pose[:3, 3] - start[:3, 3])
        pose[:3, :3] = start[:3, :3] @ se3.exp_rotation(self.scale * _turn(start, pose))
        return pose


def figure_of_eight(
    start_pose: Array,
    width: float = 0.30,
    height: float = 0.15,
    turn: float = 0.3,
    period_s: float = 8.0,
    turns: int = 1,
    ramp_s: float = 2.0,
) -> Trajectory:
    """A lying figure of eight (lemniscate of Gerono) in the base's y-z plane, begun at its crossing.

    Meanwhile the tool tilts by up to ``turn`` rad about its x axis, twice per eight, and about its y axis, once.
    ``width`` (along y) and ``height`` (along z) in m; ``period_s`` is one eight at full speed, ``ramp_s`` the time of
    each ramp. With these defaults: 10 s, 0.167 m/s and 0.2 m/s2 at the fastest.
    """

    def curve(phase: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        once, twice = math.sin(phase), math.sin(2.0 * phase)
        return (0.0, 0.5 * width * once, 0.5 * height * twice), (turn * twice, turn * once, 0.0)

    _finite(width=width, height=height, turn=turn)
    return _curve(start_pose, curve, period_s, turns, ramp_s)


def circle(
    start_pose: Array,
    diameter: float = 0.20,
    turn: float = 0.3,
    period_s: float = 8.0,
    turns: int = 1,
    ramp_s: float = 2.0,
) -> Trajectory:
    """A circle in the base's y-z plane, begun at its lowest point, with the tool leaning outward by up to ``turn`` rad.

    ``diameter`` in m; the other arguments as for :func:`figure_of_eight`. The lean vanishes at the start.
    """

    def curve(phase: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        across, up = math.sin(phase), 1.0 - math.cos(phase)
        return (0.0, 0.5 * diameter * across, 0.5 * diameter * up), (turn * across, 0.5 * turn * up, 0.0)

    _finite(diameter=diameter, turn=turn)
    return _curve(start_pose, curve, period_s, turns, ramp_s)


def straight_line(
    from_pose: Array,
    to_pose: Array,
    linear_speed: float = 0.2,
    angular_speed: float = 0.5,
    linear_acceleration: float = 0.3,
    angular_acceleration: float = 1.0,
) -> Trajectory:
    """Straight from pose to pose with the shortest turn, as fast as the bounds allow and no faster.

    Bounds in m/s, rad/s, m/s2 and rad/s2. The way to the start of a recorded path is such a line.
    """
    bounds = {
        "linear_speed": linear_speed,
        "angular_speed": angular_speed,
        "linear_acceleration": linear_acceleration,
        "angular_acceleration": angular_acceleration,
    }
    for name, bound in bounds.items():
        _positive(name, bound)
    start, end = se3.checked_pose(from_pose, "from_pose"), se3.checked_pose(to_pose, "to_pose")
    distance = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    angle = float(np.linalg.norm(_turn(start, end)))
    duration_s = max(
        PEAK_SPEED * distance / linear_speed,
        PEAK_SPEED * angle / angular_speed,
        math.sqrt(PEAK_ACCELERATION * distance / linear_acceleration),
        math.sqrt(PEAK_ACCELERATION * angle / angular_acceleration),
    )
    return StraightLine(start, end, duration_s)


def hold(pose: Array, duration_s: float = 5.0) -> Trajectory:
    """A constant pose."""
    if not (math.isfinite(duration_s) and duration_s >= 0.0):
        raise InputError(f"duration_s is {duration_s}; expected 0 or more")
    checked = se3.checked_pose(pose)
    return StraightLine(checked, checked, duration_s)


def there_and_back(start_pose: Array, distance: float = 0.2, turn: float = 0.4) -> Trajectory:
    """A straight line of ``distance`` m along the base's y with a turn of ``turn`` rad about the tool's z, and back."""
    _finite(distance=distance, turn=turn)
    start = se3.checked_pose(start_pose, "start_pose")
    end = start.copy()
    end[1, 3] += distance
    end[:3, :3] = end[:3, :3] @ se3.exp_rotation(np.array([0.0, 0.0, turn]))
    return sequence(straight_line(start, end), hold(end, 0.5), straight_line(end, start))


def sequence(*parts: Trajectory) -> Trajectory:
    """One trajectory after the other; each must begin where the one before ends (1e-6 m, 1e-6 rad), else InputError."""
    if not parts:
        raise InputError("a sequence needs at least one trajectory")
    for index, (before, after) in enumerate(pairwise(parts), start=1):
        end, begin = before.pose(before.duration_s), after.pose(0.0)
        gap, angle = np.linalg.norm(end[:3, 3] - begin[:3, 3]), np.linalg.norm(_turn(end, begin))
        if max(gap, angle) > 1e-6:
            raise InputError(f"part {index + 1} begins {gap:.3g} m and {angle:.3g} rad from where part {index} ends")
    return Sequence(parts)


SHAPES: Mapping[str, Callable[[Array], Trajectory]] = {
    "figure_of_eight": figure_of_eight,
    "circle": circle,
    "line": there_and_back,
    "hold": hold,
}
"""Name -> trajectory from a start pose, for command lines; the first is the default demonstration."""


def _curve(start_pose: Array, curve: PhaseCurve, period_s: float, turns: int, ramp_s: float) -> Trajectory:
    if turns < 1:
        raise InputError(f"turns is {turns}; expected 1 or more")
    _positive("period_s", period_s)
    timing = Cruise(2.0 * math.pi * turns, 2.0 * math.pi / period_s, ramp_s)
    return CurveTrajectory(se3.checked_pose(start_pose, "start_pose"), curve, timing)


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name} is {value}; expected a positive number")


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise InputError(f"{name} is {value}; expected a finite number")


def _turn(from_pose: Array, to_pose: Array) -> Array:
    """Rotation vector of the shortest turn, in the axes of ``from_pose``."""
    return se3.log_rotation(from_pose[:3, :3].T @ to_pose[:3, :3])

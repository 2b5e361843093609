"""Joint bounds at this tick: velocity, acceleration and position limits as one box on qd that never becomes empty.

A command stands until the next one, for a time T' that is not known beforehand but at most ``dt_max_s`` = T. So a
velocity is allowed only if, held for T and lowered by a T in each hold after that (a: acceleration limit), the joint
stops before its position limit. The held staircase of v stops after ::

    D(v) = T v + D(v - a T) ,  D(v) = 0 for v <= 0        (piecewise linear, convex)

and its inverse is, with delta = d / (a T^2) and p = floor((-1 + sqrt(1 + 8 delta)) / 2) ::

    vbar(d) = a T (delta / (p + 1) + p / 2)

The box of one joint is the meeting of three intervals, q and v = the last command, held for ``elapsed_s`` ::

    velocity      -vmax           .. vmax
    acceleration   v - a elapsed  .. v + a elapsed
    position      -vbar(q - lower) .. vbar(upper - q)

It is not empty at any later tick whatever was chosen in it: slopes of D are T ceil(v / (a T)) >= v / a, so that
D(v - a T') + T' v <= D(v) for every hold T' <= T. Outside a position limit its interval forces the joint back, at
vbar of the excess and never faster than ``recovery_speed``. Where intervals do not meet (a start outside, noise, limits
that were lowered) position gives way to acceleration and acceleration to velocity, each by the least amount.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import SettingsError
from ik_node.jit import compiled, elementwise
from ik_node.math.types import Array
from ik_node.robot.robot import Robot
from ik_node.settings.groups import LimitSettings

ROUNDING = 1e-9
"""Trespasses up to this, rad/s (m/s), are rounding."""

UNBOUNDED = 1e6
"""Distances to a position limit beyond this one, rad or m, count as this one."""


class MotionLimits(NamedTuple):
    """What no joint exceeds, (n,) each, and the longest hold these limits are kept for."""

    lower: Array
    """Position limits, rad (m); -inf where there is none."""
    upper: Array
    """Position limits, rad (m); inf where there is none."""
    velocity: Array
    """rad/s (m/s), > 0; inf where there is none."""
    acceleration: Array
    """rad/s2 (m/s2), > 0."""
    dt_max_s: float
    """No command stands longer than this; longer is a fault of its own."""
    recovery_speed: float
    """How fast a joint outside a position limit is brought back, rad/s (m/s)."""


class JointBounds(NamedTuple):
    """The box lo <= qd <= hi of one tick, (n,) each, rad/s (m/s), and the intervals it was made of."""

    lo: Array
    hi: Array
    velocity: Array
    """Velocity limit."""
    reach_lo: Array
    """The least velocity that the acceleration limit allows."""
    reach_hi: Array
    """The highest velocity that the acceleration limit allows."""
    position_lo: Array
    """The least velocity that the lower position limit allows."""
    position_hi: Array
    """The highest velocity that the upper position limit allows."""


def motion_limits(robot: Robot, settings: LimitSettings, rate_hz: float) -> MotionLimits:
    """The limits of ``robot``'s joints: the settings' where given (one for all, or one per joint), else the URDF's.

    Raises SettingsError naming the parameter where a list fits neither the number of joints nor one, or where position
    limits leave nothing between them.
    """
    lower = _per_joint(settings.position_lower, robot, "limits.position_lower", robot.limits.lower)
    upper = _per_joint(settings.position_upper, robot, "limits.position_upper", robot.limits.upper)
    velocity = _per_joint(settings.velocity, robot, "limits.velocity", robot.limits.velocity)
    acceleration = _per_joint(settings.acceleration, robot, "limits.acceleration", None)
    lower, upper = lower + settings.position_margin, upper - settings.position_margin
    for name, low, high in zip(robot.joints, lower.tolist(), upper.tolist(), strict=True):
        if not low < high:
            raise SettingsError(
                f"no position left for joint '{name}' within its limits and limits.position_margin: {low:g}, {high:g}"
            )
    return MotionLimits(
        lower,
        upper,
        velocity * settings.velocity_fraction,
        acceleration,
        settings.hold_periods / rate_hz,
        settings.recovery_speed,
    )


def _per_joint(values: tuple[float, ...], robot: Robot, name: str, otherwise: Array | None) -> Array:
    if not values and otherwise is not None:
        return otherwise
    if len(values) not in (1, robot.n):
        raise SettingsError(
            f"{name} has {len(values)} values; expected 1 or {robot.n}, in the order {', '.join(robot.joints)}"
        )
    return np.full(robot.n, values[0]) if len(values) == 1 else np.array(values)


@compiled
def viable_speed_at(distance: float, acceleration: float, hold_s: float, change_s: float) -> float:
    """:func:`viable_speed` of one distance."""
    step = acceleration * change_s
    delta = min(max(distance, 0.0), UNBOUNDED) / (step * hold_s)
    steps = np.floor(0.5 * np.sqrt(1.0 + 8.0 * delta) - 0.5)
    return float(step * (delta / (steps + 1.0) + 0.5 * steps))


_viable_speeds = elementwise(viable_speed_at)


def viable_speed(distance: ArrayLike, acceleration: ArrayLike, hold_s: float, change_s: float | None = None) -> Array:
    """vbar(d): the highest speed from which a held staircase stops within ``distance``; 0 where that is negative.

    ``hold_s``: how long each command stands. ``change_s``: the time that the change acceleration * change_s from one
    command to the next refers to; the hold unless stated.
    """
    return np.asarray(_viable_speeds(distance, acceleration, hold_s, hold_s if change_s is None else change_s))


def stopping_distance(speed: Array, acceleration: ArrayLike, hold_s: float) -> Array:
    """D(v): how far a joint still goes at ``speed`` >= 0 held for ``hold_s`` and lowered in each hold after it."""
    step = np.asarray(acceleration) * hold_s
    holds = np.ceil(speed / step)
    return np.asarray(hold_s * (holds * speed - step * holds * (holds - 1.0) / 2.0))


@compiled
def largest_change(acceleration: Array, elapsed_s: float, dt_max_s: float) -> Array:
    """(n,): by how much velocities can have changed after a command has stood for ``elapsed_s``, rad/s (m/s).

    Negative counts as 0 and more than ``dt_max_s`` as that.
    """
    return acceleration * min(max(elapsed_s, 0.0), dt_max_s)


@compiled
def joint_bounds(limits: MotionLimits, q: Array, qd_previous: Array, elapsed_s: float) -> JointBounds:
    """The box of this tick; see the module.

    ``q`` (n,) measured positions. ``qd_previous`` (n,) the command that stands now. ``elapsed_s``: for how long it has
    stood; negative counts as 0 and more than dt_max as dt_max.
    """
    held_s, n = min(max(elapsed_s, 0.0), limits.dt_max_s), len(q)
    lo, hi, reach_lo, reach_hi = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    position_lo, position_hi = np.empty(n), np.empty(n)
    for i in range(n):
        change, fastest = limits.acceleration[i] * held_s, limits.velocity[i]
        reach_lo[i], reach_hi[i] = qd_previous[i] - change, qd_previous[i] + change
        position_lo[i] = -_speed_towards(q[i] - limits.lower[i], limits, i)
        position_hi[i] = _speed_towards(limits.upper[i] - q[i], limits, i)
        # Position gives way to acceleration, acceleration to velocity.
        lowest = min(max(position_lo[i], reach_lo[i]), reach_hi[i])
        highest = max(min(position_hi[i], reach_hi[i]), reach_lo[i])
        hi[i] = min(max(highest, -fastest), fastest)
        lo[i] = min(max(lowest, -fastest), fastest, hi[i])
    return JointBounds(lo, hi, limits.velocity, reach_lo, reach_hi, position_lo, position_hi)


@compiled
def _speed_towards(distance: float, limits: MotionLimits, joint: int) -> float:
    """The highest speed towards a position limit at this distance, rad/s (m/s); negative: back from beyond it."""
    speed = viable_speed_at(abs(distance), limits.acceleration[joint], limits.dt_max_s, limits.dt_max_s)
    return speed if distance >= 0.0 else -min(speed, limits.recovery_speed)


def cause(bounds: JointBounds, joint: int, upper: bool) -> str:
    """Which limit made a side of the box: ``velocity``, ``acceleration`` or ``position``."""
    value = (bounds.hi if upper else bounds.lo)[joint]
    if abs(value) == bounds.velocity[joint]:
        return "velocity"
    if value == (bounds.position_hi if upper else bounds.position_lo)[joint]:
        return "position"
    return "acceleration"


@compiled
def nothing_conceded(bounds: JointBounds) -> bool:
    """True where :func:`conceded` has nothing to say."""
    for i in range(len(bounds.lo)):
        lo, hi = bounds.lo[i], bounds.hi[i]
        if bounds.position_hi[i] < hi - ROUNDING or bounds.position_lo[i] > lo + ROUNDING:
            return False
        if bounds.reach_hi[i] < lo - ROUNDING or bounds.reach_lo[i] > hi + ROUNDING:
            return False
    return True


def conceded(bounds: JointBounds, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Limits that had to give way to a stronger one, by name: ``position panda_joint4``; the usual answer is ()."""
    if nothing_conceded(bounds):
        return ()
    position = (bounds.position_hi < bounds.hi - ROUNDING) | (bounds.position_lo > bounds.lo + ROUNDING)
    acceleration = (bounds.reach_hi < bounds.lo - ROUNDING) | (bounds.reach_lo > bounds.hi + ROUNDING)
    names = [f"position {joints[index]}" for index in np.flatnonzero(position)]
    return (*names, *(f"acceleration {joints[index]}" for index in np.flatnonzero(acceleration)))

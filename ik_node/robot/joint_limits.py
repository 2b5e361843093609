"""Joint bounds of one control step: velocity, acceleration and position limits as one box on qd that is never empty.

A command is held until the next one, for a time T' that is not known in advance but at most ``dt_max_s`` = T. A
velocity is therefore admissible only if the joint stops before its position limit when the velocity is held for T and
then decreased by a T in each further interval (a: acceleration limit). The stopping distance of this staircase is ::

    D(v) = T v + D(v - a T) ,  D(v) = 0 for v <= 0        (piecewise linear, convex)

and its inverse is, with delta = d / (a T^2) and p = floor((-1 + sqrt(1 + 8 delta)) / 2) ::

    vbar(d) = a T (delta / (p + 1) + p / 2)

The box of one joint is the intersection of three intervals, with v the last command, held for ``elapsed_s`` ::

    velocity      -vmax           .. vmax
    acceleration   v - a elapsed  .. v + a elapsed
    position      -vbar(q - lower) .. vbar(upper - q)

It is not empty in any later control step, whatever was chosen in it: the slopes of D are T ceil(v / (a T)) >= v / a,
so D(v - a T') + T' v <= D(v) for every T' <= T. Outside a position limit the interval forces the joint back, at vbar of
the excess and not faster than ``recovery_speed``. Where the intervals do not intersect (a start outside, noise, reduced
limits), the position limit is relaxed before the acceleration limit, and that before the velocity limit, each by the
least amount.

A velocity limit that is lowered below the last command is approached at the acceleration limit
(``DifferentialIkSolver.lower_velocity_limits``); otherwise no command exceeds the limit in force.

The limits of a URDF count as none only where it says so: a continuous joint has no position limits, and without
<limit> no velocity limit. Every other velocity limit of 0 or less, and position limits with lower >= upper, are
:class:`LimitFault` s, which :func:`motion_limits` refuses unless the settings give the value.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ik_node.errors import InputError, SettingsError
from ik_node.jit import compiled, elementwise
from ik_node.math.types import Array
from ik_node.robot.description import JointRecord
from ik_node.robot.kinematics import JointLimits
from ik_node.settings.groups import LimitSettings

ROUNDING = 1e-9
"""Violations up to this, rad/s (m/s), are rounding errors."""

UNBOUNDED = 1e6
"""Larger distances to a position limit, rad or m, are set to this value."""


class LimitFault(NamedTuple):
    """A limit of the URDF that cannot be meant."""

    joint: str
    quantity: str
    """``velocity`` or ``position``."""
    text: str
    """Names the joint and the limit."""


class LimitedArm(Protocol):
    """Properties of a robot that :func:`motion_limits` needs."""

    @property
    def n(self) -> int:
        """Number of joints."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""

    @property
    def limits(self) -> JointLimits:
        """Limits of the URDF."""

    @property
    def limit_faults(self) -> tuple[LimitFault, ...]:
        """Limits of the URDF that cannot be meant; infinite in ``limits``."""


class MotionLimits(NamedTuple):
    """Limits of the joints, (n,) each, and the longest time for which a command is held."""

    lower: Array
    """Position limits, rad (m); -inf where there is none."""
    upper: Array
    """Position limits, rad (m); inf where there is none."""
    velocity: Array
    """rad/s (m/s), > 0; inf where there is none."""
    acceleration: Array
    """rad/s2 (m/s2), > 0."""
    dt_max_s: float
    """Longest time for which a command is held, s."""
    recovery_speed: float
    """Largest speed at which a joint outside a position limit is moved back, rad/s (m/s)."""


class JointBounds(NamedTuple):
    """The box lo <= qd <= hi of one control step, (n,) each, rad/s (m/s), and the intervals that it results from."""

    lo: Array
    hi: Array
    velocity: Array
    """Velocity limit."""
    reach_lo: Array
    """Smallest velocity within the acceleration limit."""
    reach_hi: Array
    """Largest velocity within the acceleration limit."""
    position_lo: Array
    """Smallest velocity that the lower position limit admits."""
    position_hi: Array
    """Largest velocity that the upper position limit admits."""


def urdf_limits(lower: Array, upper: Array, velocity: Array) -> JointLimits:
    """Limits of a URDF, with infinite values where the URDF states no limit.

    Args:
        lower: Lower position limits, (m,), rad (m).
        upper: Upper position limits, (m,), rad (m). Limits with ``lower >= upper`` count as none.
        velocity: Velocity limits, (m,), rad/s (m/s). A limit of 0 or less counts as none.

    Returns:
        The limits.
    """
    limited = lower < upper
    return JointLimits(
        np.where(limited, lower, -np.inf), np.where(limited, upper, np.inf), np.where(velocity > 0.0, velocity, np.inf)
    )


def limit_faults(joints: Mapping[str, JointRecord]) -> tuple[LimitFault, ...]:
    """Finds the limits of a URDF that cannot be meant.

    Args:
        joints: Controlled joints by the name that settings and messages use.

    Returns:
        The faults, in the order of the joints.
    """
    faults = []
    for name, joint in joints.items():
        if joint.type == "continuous" and joint.limit is None:
            continue
        given = {} if joint.limit is None else joint.limit
        velocity, lower, upper = (_number(given.get(key, "0")) for key in ("velocity", "lower", "upper"))
        if not velocity > 0.0:
            text = f"joint '{name}' has velocity limit {velocity:g} in the URDF"
            faults.append(LimitFault(name, "velocity", text))
        if joint.type != "continuous" and not lower < upper:
            text = f"joint '{name}' has position limits {lower:g} to {upper:g} in the URDF"
            faults.append(LimitFault(name, "position", text))
    return tuple(faults)


def _number(text: str) -> float:
    """The number in a text, NaN for none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def _refuse(faults: Iterable[LimitFault], settings: LimitSettings) -> None:
    """Raises SettingsError for the faults of the URDF whose values the settings do not give."""
    given = {"velocity": bool(settings.velocity), "position": bool(settings.position_lower and settings.position_upper)}
    needed = {"velocity": "limits.velocity", "position": "limits.position_lower and limits.position_upper"}
    open_faults = [fault for fault in faults if not given[fault.quantity]]
    if open_faults:
        names = " and ".join(dict.fromkeys(needed[fault.quantity] for fault in open_faults))
        raise SettingsError(f"{', '.join(fault.text for fault in open_faults)}; set {names}")


def motion_limits(robot: LimitedArm, settings: LimitSettings, rate_hz: float) -> MotionLimits:
    """Limits of a robot: those of the settings where given, else those of the URDF.

    Args:
        robot: The robot.
        settings: Limits, one for all joints or one per joint, and margins.
        rate_hz: Nominal rate of the control steps.

    Returns:
        The limits.

    Raises:
        SettingsError: A list matches neither the number of joints nor has one value, the position limits leave no
            range, or a limit is a fault of the URDF and not given; names the parameter.
    """
    _refuse(robot.limit_faults, settings)
    lower = _per_joint(settings.position_lower, robot, "limits.position_lower", robot.limits.lower)
    upper = _per_joint(settings.position_upper, robot, "limits.position_upper", robot.limits.upper)
    velocity = _per_joint(settings.velocity, robot, "limits.velocity", robot.limits.velocity)
    acceleration = _per_joint(settings.acceleration, robot, "limits.acceleration", None)
    lower, upper = lower + settings.position_margin, upper - settings.position_margin
    for name, low, high in zip(robot.joints, lower.tolist(), upper.tolist(), strict=True):
        if not low < high:
            raise SettingsError(
                f"joint '{name}' has no range between limits.position_lower and limits.position_upper less "
                f"limits.position_margin: {low:g} to {high:g}; valid: lower < upper"
            )
    return MotionLimits(
        lower,
        upper,
        velocity * settings.velocity_fraction,
        acceleration,
        settings.hold_periods / rate_hz,
        settings.recovery_speed,
    )


def _per_joint(values: tuple[float, ...], robot: LimitedArm, name: str, otherwise: Array | None) -> Array:
    if not values and otherwise is not None:
        return otherwise
    if len(values) not in (1, robot.n):
        raise SettingsError(
            f"{name} has {len(values)} values; expected 1 or {robot.n}, in the order {', '.join(robot.joints)}"
        )
    return np.full(robot.n, values[0]) if len(values) == 1 else np.array(values)


@compiled
def viable_speed_at(distance: float, acceleration: float, hold_s: float, change_s: float) -> float:
    """:func:`viable_speed` for one distance."""
    step = acceleration * change_s
    delta = min(max(distance, 0.0), UNBOUNDED) / (step * hold_s)
    steps = np.floor(0.5 * np.sqrt(1.0 + 8.0 * delta) - 0.5)
    return float(step * (delta / (steps + 1.0) + 0.5 * steps))


_viable_speeds = elementwise(viable_speed_at)


def viable_speed(distance: ArrayLike, acceleration: ArrayLike, hold_s: float, change_s: float | None = None) -> Array:
    """Computes vbar(d), the largest speed from which the staircase of commands stops within a distance.

    Args:
        distance: d, rad (m); a negative distance gives 0.
        acceleration: Limit a, rad/s2 (m/s2).
        hold_s: Time T for which each command is held, s.
        change_s: The speed decreases by acceleration * change_s from one command to the next; default: hold_s.

    Returns:
        vbar, rad/s (m/s), with the common shape of the arguments.
    """
    return np.asarray(_viable_speeds(distance, acceleration, hold_s, hold_s if change_s is None else change_s))


def stopping_distance(speed: Array, acceleration: ArrayLike, hold_s: float) -> Array:
    """Computes D(v), the stopping distance of the staircase of commands.

    Args:
        speed: v >= 0, rad/s (m/s).
        acceleration: Limit a, rad/s2 (m/s2).
        hold_s: Time T for which each command is held, s.

    Returns:
        D, rad (m).
    """
    step = np.asarray(acceleration) * hold_s
    holds = np.ceil(speed / step)
    return np.asarray(hold_s * (holds * speed - step * holds * (holds - 1.0) / 2.0))


@compiled
def largest_change(acceleration: Array, elapsed_s: float, dt_max_s: float) -> Array:
    """Largest change of the joint velocities after the last command was held for ``elapsed_s``, (n,), rad/s (m/s).

    ``elapsed_s`` is limited to 0..``dt_max_s``.
    """
    return acceleration * min(max(elapsed_s, 0.0), dt_max_s)


@compiled
def joint_bounds(limits: MotionLimits, q: Array, qd_previous: Array, elapsed_s: float) -> JointBounds:
    """Computes the box of one control step; see the module docstring.

    Args:
        limits: Limits of the joints.
        q: Measured positions, (n,), rad (m).
        qd_previous: Last command, (n,), rad/s (m/s).
        elapsed_s: Time since the last command, s; limited to 0..dt_max_s.

    Returns:
        The box and its intervals.
    """
    held_s, n = min(max(elapsed_s, 0.0), limits.dt_max_s), len(q)
    lo, hi, reach_lo, reach_hi = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    position_lo, position_hi = np.empty(n), np.empty(n)
    for i in range(n):
        change, fastest = limits.acceleration[i] * held_s, limits.velocity[i]
        reach_lo[i], reach_hi[i] = qd_previous[i] - change, qd_previous[i] + change
        position_lo[i] = -_speed_towards(q[i] - limits.lower[i], limits, i)
        position_hi[i] = _speed_towards(limits.upper[i] - q[i], limits, i)
        # The position limit is relaxed before the acceleration limit, and that before the velocity limit.
        lowest = min(max(position_lo[i], reach_lo[i]), reach_hi[i])
        highest = max(min(position_hi[i], reach_hi[i]), reach_lo[i])
        hi[i] = min(max(highest, -fastest), fastest)
        lo[i] = min(max(lowest, -fastest), fastest, hi[i])
    return JointBounds(lo, hi, limits.velocity, reach_lo, reach_hi, position_lo, position_hi)


@compiled
def _speed_towards(distance: float, limits: MotionLimits, joint: int) -> float:
    """Largest speed towards a position limit at this distance, rad/s (m/s); negative beyond the limit."""
    speed = viable_speed_at(abs(distance), limits.acceleration[joint], limits.dt_max_s, limits.dt_max_s)
    return speed if distance >= 0.0 else -min(speed, limits.recovery_speed)


def cause(bounds: JointBounds, joint: int, upper: bool) -> str:
    """The limit that determines a side of the box: ``velocity``, ``acceleration`` or ``position``."""
    value = (bounds.hi if upper else bounds.lo)[joint]
    if abs(value) == bounds.velocity[joint]:
        return "velocity"
    if value == (bounds.position_hi if upper else bounds.position_lo)[joint]:
        return "position"
    return "acceleration"


@compiled
def nothing_relaxed(bounds: JointBounds) -> bool:
    """True when :func:`relaxed` is empty."""
    for i in range(len(bounds.lo)):
        lo, hi = bounds.lo[i], bounds.hi[i]
        if bounds.position_hi[i] < hi - ROUNDING or bounds.position_lo[i] > lo + ROUNDING:
            return False
        if bounds.reach_hi[i] < lo - ROUNDING or bounds.reach_lo[i] > hi + ROUNDING:
            return False
    return True


def relaxed(bounds: JointBounds, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Names of the limits that were relaxed in favour of another one, e.g. ``position panda_joint4``; usually ()."""
    if nothing_relaxed(bounds):
        return ()
    position = (bounds.position_hi < bounds.hi - ROUNDING) | (bounds.position_lo > bounds.lo + ROUNDING)
    acceleration = (bounds.reach_hi < bounds.lo - ROUNDING) | (bounds.reach_lo > bounds.hi + ROUNDING)
    names = [f"position {joints[index]}" for index in np.flatnonzero(position)]
    return (*names, *(f"acceleration {joints[index]}" for index in np.flatnonzero(acceleration)))


@compiled
def exceeds(velocity: Array, limit: Array) -> bool:
    """True if an entry of ``velocity`` (n,), rad/s (m/s), is over its ``limit`` (n,) by more than rounding."""
    for i in range(len(velocity)):  # noqa: SIM110 - numba does not compile any() of a generator
        if abs(velocity[i]) > limit[i] + ROUNDING:
            return True
    return False


def within_velocity_limits(velocity: Array, limit: Array) -> Array:
    """The last check: ``velocity`` (n,), rad/s (m/s), is finite, and clipped to the velocity limits ``limit`` (n,).

    Raises:
        InputError: It is not finite or exceeds a limit by more than rounding. Either is a defect of this package, and
            the arm has to stop.
    """
    if not np.isfinite(velocity).all():
        raise InputError(f"the computed joint velocity is not finite: {velocity}")
    clipped = np.minimum(np.maximum(velocity, -limit), limit)
    if np.abs(clipped - velocity).max() > ROUNDING:
        raise InputError(f"the computed joint velocity exceeds its limits: {velocity}")
    return clipped

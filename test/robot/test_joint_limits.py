"""Joint bounds: for any choice inside the box and any timing, no later box is empty and no limit is violated.

Many independent one-joint "lanes" run at once, each with its own limits and choices. The choices are adversarial:
always to a limit, back and forth, random. Not tested here: the choice itself (test_constrained.py).
"""

from __future__ import annotations

import numpy as np
import pytest

from ik_node.errors import SettingsError
from ik_node.math.types import Array
from ik_node.robot import catalogue
from ik_node.robot.joint_limits import (
    JointBounds,
    MotionLimits,
    cause,
    joint_bounds,
    motion_limits,
    relaxed,
    stopping_distance,
    viable_speed,
)
from ik_node.settings.groups import ArmSettings, LimitSettings

LANES = 600


def lanes(rng: np.random.Generator, dt_max_s: float) -> MotionLimits:
    """Joints between 1e-4 and 6 rad wide, 0.1 to 10 rad/s, 0.5 to 100 rad/s2; every tenth without position limits."""
    width = 10.0 ** rng.uniform(-4.0, 0.8, LANES)
    lower = rng.uniform(-3.0, 3.0, LANES)
    upper = lower + width
    lower[::10], upper[::10] = -np.inf, np.inf
    velocity, acceleration = 10.0 ** rng.uniform(-1.0, 1.0, LANES), 10.0 ** rng.uniform(-0.3, 2.0, LANES)
    return MotionLimits(lower, upper, velocity, acceleration, dt_max_s, 0.1)


def hostile_choice(rng: np.random.Generator, tick: int, bounds: JointBounds) -> Array:
    """A third of the lanes at the upper end of the box, a third alternating, a third anywhere in it."""
    share = rng.uniform(size=LANES)
    share[: LANES // 3] = 1.0
    share[LANES // 3 : 2 * LANES // 3] = (tick // 40) % 2
    return np.clip(bounds.lo + share * (bounds.hi - bounds.lo), bounds.lo, bounds.hi)


@pytest.mark.parametrize("dt_max_s", [0.001, 0.01, 0.05])
def test_no_limit_is_ever_broken_and_the_box_is_never_empty(dt_max_s: float) -> None:
    """The property the module guarantees: from rest inside the limits, with commands held for any time up to dt_max."""
    rng = np.random.default_rng(1)
    limits = lanes(rng, dt_max_s)
    q, inside = np.zeros(LANES), np.isfinite(limits.lower)
    q[inside] = limits.lower[inside] + rng.uniform(size=inside.sum()) * (limits.upper - limits.lower)[inside]
    v, elapsed_s, touched = np.zeros(LANES), 0.2 * dt_max_s, 0
    for tick in range(1500):
        bounds = joint_bounds(limits, q, v, elapsed_s)
        assert (bounds.lo <= bounds.hi).all()
        # Not empty before rounding either: no limit was relaxed.
        assert relaxed(bounds, tuple(map(str, range(LANES)))) == ()
        new = hostile_choice(rng, tick, bounds)
        assert (np.abs(new - v) <= limits.acceleration * elapsed_s + 1e-12).all()
        assert (np.abs(new) <= limits.velocity).all()
        v, elapsed_s = new, dt_max_s * rng.choice([0.04, 0.2, 0.5, 1.0])
        q = q + elapsed_s * v
        assert (q <= limits.upper + 1e-12).all()
        assert (q >= limits.lower - 1e-12).all()
        touched += int((limits.upper - q < 1e-9).sum())
    assert touched > 1000  # The limits were reached.


def test_the_speed_is_the_inverse_of_the_stopping_distance() -> None:
    """vbar inverts D; the reference is the definition of D (the staircase, summed); both over ten decades."""
    rng = np.random.default_rng(2)
    for hold_s, acceleration in ((0.001, 1.0), (0.01, 20.0), (0.05, 100.0)):
        distance = 10.0 ** rng.uniform(-9.0, 1.0, 2000)
        speed = viable_speed(distance, acceleration, hold_s)
        assert stopping_distance(speed, acceleration, hold_s) == pytest.approx(distance, rel=1e-11)
        summed, v = np.zeros(2000), speed.copy()
        while (v > 0.0).any():
            summed += hold_s * np.maximum(v, 0.0)
            v -= acceleration * hold_s
        assert summed == pytest.approx(distance, rel=1e-8)
    assert viable_speed(np.array([-1.0, 0.0]), 1.0, 0.01).tolist() == [0.0, 0.0]


def test_the_bound_is_tight() -> None:
    """The bound is not conservative: at a speed 1e-6 above vbar, commands held for dt_max overshoot."""
    distance, acceleration, hold_s = 0.3, 10.0, 0.01
    q, v = 0.0, float(viable_speed(np.array([distance]), acceleration, hold_s)[0]) + 1e-6
    while v > 0.0:
        q, v = q + hold_s * v, v - acceleration * hold_s
    assert q > distance + 1e-9


def test_a_joint_outside_a_limit_returns_at_bounded_speed_and_stays_inside() -> None:
    """Arms may start outside. Outward motion stops within the braking distance; the return is at recovery_speed."""
    rng = np.random.default_rng(3)
    limits = MotionLimits(
        np.full(LANES, -1.0), np.full(LANES, 1.0), np.full(LANES, 3.0), np.full(LANES, 10.0), 0.01, 0.1
    )
    excess = 10.0 ** rng.uniform(-12.0, -0.5, LANES)
    q = np.where(rng.uniform(size=LANES) < 0.5, 1.0 + excess, -1.0 - excess)
    v = rng.uniform(0.0, 1.0, LANES) * np.sign(q)
    start, speed = np.abs(q), np.abs(v)
    unavoidable = start + stopping_distance(speed, 10.0, 0.01)
    inside = np.zeros(LANES, dtype=bool)
    for tick in range(5000):
        bounds = joint_bounds(limits, q, v, 0.002)
        assert (bounds.lo <= bounds.hi).all()
        new = hostile_choice(rng, tick, bounds)
        assert (np.abs(new - v) <= 10.0 * 0.002 + 1e-12).all()
        outside, outward = np.abs(q) > 1.0, v * np.sign(q)
        highest = np.where(q > 0.0, bounds.hi, -bounds.lo)  # Outward.
        still = outside & (np.abs(outward) < 0.02)
        assert (highest[outside & (outward > 0.02)] < outward[outside & (outward > 0.02)] - 0.0199).all()  # Brakes,
        assert (highest[still] < 0.0).all()  # returns,
        assert (highest[outside & (outward > -0.1)] >= -0.1 - 1e-12).all()  # but is not forced to be fast.
        v = new
        q = q + 0.002 * v
        assert (np.abs(q) <= unavoidable + 1e-9).all()
        assert (np.abs(q[inside]) <= 1.0 + 1e-12).all()  # Stays inside after it is inside.
        inside |= np.abs(q) <= 1.0
    assert (np.abs(q) <= 1.0 + 1e-12).all()


def test_inward_motion_is_always_allowed_outside() -> None:
    """At any excess, the box contains speeds that lead back faster than required."""
    limits = MotionLimits(np.array([-1.0]), np.array([1.0]), np.array([3.0]), np.array([10.0]), 0.01, 0.1)
    for excess in (1e-12, 1e-3, 2.0):
        bounds = joint_bounds(limits, np.array([1.0 + excess]), np.array([0.0]), 0.002)
        assert bounds.lo[0] == pytest.approx(-0.02)
        assert bounds.hi[0] <= 0.0


def test_priorities_and_names() -> None:
    """Velocity before acceleration before position, and each side of the box names the limit that determines it."""
    limits = MotionLimits(np.full(4, -1.0), np.full(4, 1.0), np.full(4, 2.0), np.full(4, 10.0), 0.01, 0.1)
    # At rest in the middle; near the upper limit; too fast for it; faster than the velocity limit.
    q, v = np.array([0.0, 0.9999, 0.9999, 0.0]), np.array([0.0, 0.0, 1.5, 2.5])
    bounds = joint_bounds(limits, q, v, 0.002)
    assert bounds.hi.tolist() == pytest.approx([0.02, 0.01, 1.48, 2.0])
    assert [cause(bounds, joint, True) for joint in range(4)] == [
        "acceleration",
        "position",
        "acceleration",
        "velocity",
    ]
    assert bounds.lo.tolist() == pytest.approx([-0.02, -0.02, 1.48, 2.0])
    assert relaxed(bounds, ("a", "b", "c", "d")) == ("position c", "acceleration d")
    assert (np.abs([bounds.lo, bounds.hi]) <= 2.0).all()


def test_a_hold_longer_than_dt_max_counts_as_dt_max() -> None:
    """The permitted change must not grow in a stalled loop; the watchdog handles stalls."""
    limits = MotionLimits(np.array([-9.0]), np.array([9.0]), np.array([9.0]), np.array([10.0]), 0.01, 0.1)
    assert joint_bounds(limits, np.zeros(1), np.zeros(1), 5.0).hi[0] == pytest.approx(0.1)
    assert joint_bounds(limits, np.zeros(1), np.zeros(1), -1.0).hi[0] == 0.0


def test_settings_override_the_urdf() -> None:
    """One value for all joints, or one per joint; the error for a list of another length names the setting."""
    robot = catalogue.robot_from_settings(ArmSettings(robot="kinova"))
    limits = motion_limits(robot, LimitSettings(velocity_fraction=0.5, position_margin=0.01), 500.0)
    assert limits.velocity == pytest.approx(0.5 * robot.limits.velocity)
    assert limits.acceleration.tolist() == [10.0] * 6
    assert limits.dt_max_s == pytest.approx(0.01)
    assert np.isinf(limits.upper[robot.continuous]).all()  # Continuous joints have no position bound.
    assert limits.upper[1] == pytest.approx(robot.limits.upper[1] - 0.01)
    bounds = joint_bounds(limits, np.full(6, 2.0), np.zeros(6), 1.0)
    assert bounds.hi[robot.continuous] == pytest.approx(np.minimum(0.1, limits.velocity)[robot.continuous])
    with pytest.raises(SettingsError, match=r"limits.velocity has 2 values; expected 1 or 6"):
        motion_limits(robot, LimitSettings(velocity=(1.0, 2.0)), 500.0)
    with pytest.raises(SettingsError, match="has no range"):
        motion_limits(robot, LimitSettings(position_lower=(1.0,), position_upper=(1.0,)), 500.0)
